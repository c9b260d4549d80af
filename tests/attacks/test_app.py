"""The page of `termsel app`: a session of a stranger, and requests of others on this machine."""

from __future__ import annotations

import http.client
import json
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from termsel import TermselError
from tests.attacks.files import image, mrf, vrt

pytest.importorskip("tornado")
command = pytest.importorskip("termsel_app.command")
session = pytest.importorskip("termsel_app.session")
server_of_page = pytest.importorskip("termsel_app.server")

HEADER = {"schema": "termsel-app-1", "image": None, "maps": [], "points": None, "lines": None,
          "rpc": None, "dem": None, "crs": "local", "size": None}
KINDS_OF_NAMES = ("image", "points", "lines", "rpc", "dem", "map")
NAMES = ("a\0b", "\ud800", "x" * 5000, "@U/i.tif", "@U/i/info.json", "/vsicurl/@U/x.tif",
         "/vsicurl?proxy=&url=@U/x.tif", "WMS:@U/?", "vrt:///vsicurl/@U/y.tif", "<VRTDataset/>",
         "@V/kept.txt", "NETCDF:@V/kept.txt:x", "/dev/zero", "pipe", "scene.mrf", "remote.vrt",
         "../victim/kept.txt", "\n# a")


@pytest.fixture(autouse=True)
def without_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    """The process that judges control opens nothing of its own."""
    monkeypatch.setattr(session, "Worker", lambda *_: SimpleNamespace(
        tell=None, ask=lambda _: None, close=lambda: None))


def written(folder: Path, header: dict[str, Any], entries: list[Any] | None = None) -> Path:
    """Write the journal of a session into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [json.dumps(entry) for entry in ({**HEADER, **header}, *(entries or []))]
    (folder / "session.jsonl").write_text("\n".join(lines) + "\n")
    return folder


def opened(folder: Path) -> Any:
    """Open a session by its folder, as `termsel app DIR` does, and return it."""
    given, place = command.files_of_session(session.Files(str(folder)), None)
    with session.open_session(given, place) as made:
        return made


def point(number: int, name: str | None = None) -> dict[str, Any]:
    return {"id": name or f"P{number}", "kind": "point", "role": "", "image": [1.0, 2.0],
            "ground": [3.0, 4.0, None]}


@pytest.mark.parametrize("kind", KINDS_OF_NAMES)
def test_a_session_names_no_server_and_no_file_that_is_not_opened(
        kind: str, folder: Path, server, victim: Path) -> None:
    """A map is opened, an image too; points were read when the session began, and are not again."""
    if hasattr(os, "mkfifo"):
        os.mkfifo(folder / "pipe")
    source = image(folder / "source.tif")
    (folder / "scene.mrf").write_text(mrf(source, victim / "made.bin"))
    (folder / "remote.vrt").write_text(vrt(f"/vsicurl/{server.url}/z.tif"))
    for number, name in enumerate(NAMES):
        name = name.replace("@U", server.url).replace("@V", str(victim))
        header = {"maps": [name]} if kind == "map" else {kind: name}
        place = written(folder / str(number), header)
        try:
            assert SECRET_WORDS not in json.dumps(opened(place).state())
        except TermselError:
            continue
        assert kind not in ("image",), name


SECRET_WORDS = "nobody reads it"


@pytest.mark.parametrize("header", [
    {"image": 5}, {"image": []}, {"maps": "a"}, {"maps": [5]}, {"size": [0, 1]}, {"size": "a"},
    {"crs": {}}, {"crs": "x"}, {"schema": "termsel-app-2"}, {"size": [2**31, 1]}], ids=str)
def test_a_header_of_another_kind(header: dict[str, Any], folder: Path) -> None:
    with pytest.raises(TermselError):
        opened(written(folder / "a", header))


@pytest.mark.parametrize("entry", [
    [], 5, {}, {"change": [[None, {"id": "a"}]]}, {"change": [[None, {**point(1), "id": "a\x1b"}]]},
    {"change": [[None, {**point(1), "image": [10**400, 1]}]]}, {"undo": True}, {"redo": True},
    {"change": [[None, {**point(1), "role": ["x"]}]]}, {"change": [1]}, "[" * 5000], ids=str)
def test_an_entry_of_another_kind(entry: Any, folder: Path) -> None:
    with pytest.raises(TermselError):
        opened(written(folder / "a", {}, [entry]))


def test_a_journal_that_takes_long(folder: Path) -> None:
    """Thousands of new names, or changes undone and done again, take no more than any file."""
    many = {"change": [[None, point(i)] for i in range(6_000)]}
    renamed = [{"change": [[point(i), point(i, f"Q{i}")]]} for i in range(6_000)]
    start = time.process_time()
    made = opened(written(folder / "a", {}, [many, *renamed]))
    assert list(made.control.records) == [f"Q{i}" for i in range(6_000)]
    with pytest.raises(TermselError, match="changes of them"):
        opened(written(folder / "b", {}, [many, *[{"undo": True}, {"redo": True}] * 400]))
    assert time.process_time() - start < 4


def test_links(folder: Path, victim: Path) -> None:
    for number, name in enumerate(("session.jsonl", ".lock", "points.csv", "map.tif", "result",
                                   "result/points.csv")):
        place = written(folder / str(number), {})
        if name == "session.jsonl":
            (place / name).unlink()
        (place / name).parent.mkdir(exist_ok=True)
        (place / name).symlink_to(victim / "kept.txt")
        with pytest.raises(TermselError, match=r"this is a link|neither a session nor a result"):
            opened(place)


def test_folders_whose_names_nobody_typed(folder: Path, victim: Path, call) -> None:
    image(folder / "scan.tif")
    (folder / "scan-control").symlink_to(victim / "empty")
    (folder / "termsel-example").symlink_to(victim / "empty")
    for words in (("scan.tif", "--crs", "local"), ("--example",)):
        assert "this is a link" in call("app", *words, "--no-browser").stderr


def test_a_name_is_no_option(folder: Path) -> None:
    """A name that begins with a hyphen would be an option of the commands that are started."""
    assert session.from_folder("--allow-remote", folder) == os.path.join(".", "--allow-remote")
    assert session.from_folder(str(folder / "a.tif"), folder) == "a.tif"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A page that is served, and what it has said."""
    place = tmp_path_factory.mktemp("page")
    # The browser that is started tells with what, and asks nobody.
    code = ("import webbrowser; webbrowser.open = lambda address: print('first', address, "
            "flush=True); from termsel.__main__ import main; main()")
    words = ["termsel", "app", str(image(place / "a.tif")), "--crs", "local", "--out",
             str(place / "o")]
    with (place / "said").open("w") as said, subprocess.Popen(
            [sys.executable, "-c", f"import sys; sys.argv = {words!r}; {code}"],
            stdout=subprocess.PIPE, stderr=said, text=True) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(2)]
        found = re.search(r"http://127\.0\.0\.1:(\d+)/([\w-]{32})/", lines[0])
        first = re.search(r"first http://127\.0\.0\.1:\d+/([\w-]{32})\n", lines[1])
        assert found is not None
        assert first is not None
        yield SimpleNamespace(port=int(found[1]), secret=found[2], first=first[1],
                              said=place / "said", folder=place / "o")
        process.kill()


def ask(page: Any, path: str, method: str = "GET", body: bytes | None = None,
        **headers: str) -> tuple[int, bytes, dict[str, str]]:
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=20)
    given = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, body, given)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content, dict(answer.getheaders())


def test_the_address_that_others_may_see_leads_to_the_page_once(page: Any) -> None:
    """With what a browser is started, other users of the machine can list."""
    assert page.first != page.secret
    assert ask(page, f"/{page.first}/state")[0] == 403
    assert ask(page, f"/{page.first}", Host="example.org")[0] == 403
    status, _, headers = ask(page, f"/{page.first}")
    assert (status, headers["Location"]) == (302, f"http://127.0.0.1:{page.port}/{page.secret}/")
    assert headers["Referrer-Policy"] == "no-referrer"
    assert ask(page, f"/{page.first}")[0] == 403


def test_names_that_are_bound_anew_to_this_machine_are_refused(page: Any) -> None:
    for host in ("rebound.example", "rebound.example:@P", "127.0.0.1.example:@P", "localhost.:@P",
                 "127.0.0.1:@P.example", "0.0.0.0:@P", "[::1]:@P", "localhost", ""):
        host = host.replace("@P", str(page.port))
        for path in ("", "state", "events", "tile/image/0/0/0.png"):
            status, content, _ = ask(page, f"/{page.secret}/{path}", Host=host)
            assert status in (400, 403), host
            assert content == b""


@pytest.mark.parametrize("path", [
    "tile/image/0/0/0/../../../../../../etc/passwd", "tile/..%2f..%2fo/0/0/0.png",
    "tile/map0%2f..%2f..%2fsession/0/0/0.png", "tile/image/-1/0/0.png", "tile/image/0/0/0.png%00",
    "tile/image/0/999999999999/0.png", "..%2fsession.jsonl",
    "%2e%2e%2fa.tif", "vendor%2f..%2f..%2fserver.py", "vendor/ol.js/../../session.py", "a.tif",
    "//etc/passwd", "\\..\\a.tif", "session.jsonl", "o/session.jsonl", "page_files.py"])
def test_no_path_of_a_request_leaves_its_lists(path: str, page: Any) -> None:
    for method in ("GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "PATCH"):
        status, content, _ = ask(page, f"/{page.secret}/{path}", method,
                                 None if method == "GET" else b"")
        assert status in (400, 403, 404, 405), (method, status)
        assert content == b""


def test_bodies_of_any_size_are_not_taken(page: Any) -> None:
    place = f"/{page.secret}/call/paste"
    json_type = {"Content_Type": "application/json"}
    for body in (b"[" * 100_000, b'{"text": ' + b"[" * 100_000, b"\xff\xfe", b'{"text": "\\ud800"}',
                 b'{"text": "' + b"a," * 200_000 + b'"}', b"1" * 100_000):
        status, _, _ = ask(page, place, "POST", body, **json_type)
        assert status in (400, 422)
    for headers in ("Content-Length: 99999999999", "Transfer-Encoding: chunked"):
        with socket.create_connection(("127.0.0.1", page.port), timeout=20) as connection:
            connection.sendall((f"POST {place} HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n"
                                f"Content-Type: application/json\r\n{headers}\r\n\r\n").encode())
            try:
                for _ in range(80):  # of 100 KiB: more than any body may have
                    connection.sendall(b"19000\r\n" + b"a" * 0x19000 + b"\r\n")
                answer = connection.recv(100)
            except OSError:
                continue
            assert not answer or b" 4" in answer
    assert ask(page, f"/{page.secret}/state")[0] == 200  # it is still there


@pytest.mark.parametrize("origin", [
    "", "null", "https://127.0.0.1:@P", "http://127.0.0.1:1", "http://127.0.0.1:@P.example",
    "http://127.0.0.1", "http://rebound.example:@P", "file://", "http://localhost:@P@example"])
def test_no_other_page_hears_or_asks(origin: str, page: Any) -> None:
    headers = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec_WebSocket_Version": "13",
               "Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ=="}
    origin = origin.replace("@P", str(page.port))
    assert ask(page, f"/{page.secret}/events", Origin=origin, **headers)[0] == 403
    for given in ({"Sec_WebSocket_Origin": origin}, {"Origin": origin, "Host": "x.example"}):
        assert ask(page, f"/{page.secret}/events", **{**headers, **given})[0] == 403
    if origin:
        status, content, answered = ask(page, f"/{page.secret}/call/undo", "POST", b"{}",
                                        Origin=origin, Content_Type="application/json")
        assert (status, content) == (403, b"")
        assert not any(name.startswith("Access-Control") for name in answered)


def test_the_secret_is_in_no_log_and_no_file(page: Any) -> None:
    ask(page, f"/{page.secret}/call/nothing", "POST", b"{}", Content_Type="application/json")
    ask(page, f"/{page.secret}/tile/image/0/0/0.png")
    assert page.secret not in page.said.read_text()
    assert "Traceback" not in page.said.read_text()
    for file in page.folder.rglob("*"):
        assert file.is_dir() or page.secret.encode() not in file.read_bytes()
    assert page.secret.encode() not in ask(page, f"/{page.secret}/state")[1]


def test_a_fault_is_told_without_the_secret(caplog: pytest.LogCaptureFixture) -> None:
    handler = server_of_page.Guarded.__new__(server_of_page.Guarded)
    handler.log_exception(KeyError, KeyError("x"), None)
    assert "KeyError" in caplog.text
    assert "HTTPServerRequest" not in caplog.text


@pytest.mark.parametrize("name", [
    "https://a.example/i\r\nX: y", "https://a.example; script-src *", "https://*/i", "javascript:x",
    "https://", "file:///etc/passwd", "https://a.example 'unsafe-inline'", "https://a,b/i", "//a/b",
    "https://u@evil.example/i", 7, None, ["https://a"]], ids=repr)
def test_the_id_of_an_image_is_no_policy_and_no_header(name: object) -> None:
    """The policy of the page allows pictures of the server that an IIIF image names."""
    from termsel_app.iiif import parse_image_info

    text = json.dumps({"id": name, "width": 9, "height": 9}).encode()
    with pytest.raises(TermselError, match="no description of an IIIF image"):
        parse_image_info(text, "https://a.example/info.json")
    good = json.dumps({"id": "https://a.example:8080/i%2Fmap-1", "width": 9, "height": 8}).encode()
    assert parse_image_info(good, "").origin == "https://a.example:8080"
