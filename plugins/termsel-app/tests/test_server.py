"""The server answers its own page alone, and no request leaves what it was started with."""

from __future__ import annotations

import http.client
import json
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

from termsel import TermselError
from termsel_app.command import app

PAGE = Path(__file__).parents[1] / "src" / "termsel_app" / "page"


class Running:
    """A running `termsel app`, and requests to it."""

    def __init__(self, *arguments: str, cwd: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "termsel", "app", *arguments, "--no-browser"], cwd=cwd,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0))
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:(\d+)/([\w-]{32})/", line)
        if found is None:
            raise AssertionError(self.process.communicate())
        self.address = found[0]
        self.port = int(found[1])
        self.secret = found[2]

    def ask(self, path: str, method: str = "GET", body: Any = None,
            **headers: str) -> tuple[int, dict[str, str], bytes]:
        """Return status, headers and body of an answer; `path` follows the secret."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        given = {"Content-Type": "application/json"} if body is not None else {}
        given.update({name.replace("_", "-"): value for name, value in headers.items()})
        connection.request(method, f"/{self.secret}/{path}",
                           None if body is None else json.dumps(body), given)
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        return answer.status, dict(answer.getheaders()), content

    def call(self, name: str, /, **given: Any) -> dict[str, Any]:
        """Have the session do something."""
        status, _, content = self.ask(f"call/{name}", "POST", given)
        assert status in (200, 422), (status, content)
        answer: dict[str, Any] = json.loads(content)
        return answer

    def end(self) -> str:
        """End it as Ctrl-C does, and return what it said."""
        if self.process.poll() is None:
            self.process.send_signal(getattr(signal, "CTRL_BREAK_EVENT", signal.SIGINT))
        return self.process.communicate(timeout=30)[1]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with an image, a map, and a file that nobody may read."""
    folder = tmp_path_factory.mktemp("app")
    rng = np.random.default_rng(1)
    pixels = rng.integers(0, 255, (1, 200, 300)).astype(np.uint8)
    shape = {"driver": "GTiff", "count": 1, "height": 200, "width": 300, "dtype": "uint8"}
    with rasterio.open(folder / "scan.tif", "w", **shape) as raster:
        raster.write(pixels)
    with rasterio.open(folder / "ortho.tif", "w", crs="EPSG:25832",
                       transform=Affine(1, 0, 500000, 0, -1, 5200000), **shape) as raster:
        raster.write(pixels)
    (folder / "private.txt").write_text("private")
    return folder


@pytest.fixture(scope="module")
def running(place: Path) -> Iterator[Running]:
    """Return a running server."""
    app = Running("scan.tif", "--map", "ortho.tif", cwd=place)
    yield app
    app.end()


def test_only_this_machine_is_listened_to(running: Running) -> None:
    # Any other address of this machine refuses the connection.
    for address in ("127.0.0.2", socket.gethostname()):
        try:
            other = str(socket.getaddrinfo(address, running.port, socket.AF_INET)[0][4][0])
        except OSError:
            continue
        if other == "127.0.0.1":
            continue
        with pytest.raises((ConnectionError, TimeoutError)), \
                socket.create_connection((other, running.port), timeout=2):
            pass


def test_nobody_is_answered_without_the_secret(running: Running) -> None:
    for path in ("/", "/state", "/x/state", f"/{'a' * 32}/", f"/{'a' * 32}/state", "/favicon.ico",
                 f"/{'a' * 32}/tile/image/0/0/0.png", f"//{running.secret}/",
                 f"/{running.secret[:-1]}/", f"/{'a' * 32}/events", f"/{running.secret}x/app.js"):
        connection = http.client.HTTPConnection("127.0.0.1", running.port, timeout=20)
        connection.request("GET", path)
        answer = connection.getresponse()
        assert (answer.status, answer.read()) == (403, b""), path
        connection.close()


@pytest.mark.parametrize("headers", [
    {"Host": "example.org"}, {"Host": "127.0.0.1"}, {"Host": "attacker.example:{port}"},
    {"Origin": "https://example.org"}, {"Origin": "null"}, {"Origin": "http://127.0.0.1:1"},
    {"Origin": "https://127.0.0.1:{port}"}, {"Sec_Fetch_Site": "cross-site"},
    {"Sec_Fetch_Site": "same-site"}])
def test_a_request_from_elsewhere_is_refused_though_it_has_the_secret(
        running: Running, headers: dict[str, str]) -> None:
    given = {key: value.format(port=running.port) for key, value in headers.items()}
    for path, method, body in (("state", "GET", None), ("call/undo", "POST", {}), ("", "GET", None),
                               ("tile/image/0/0/0.png", "GET", None)):
        status, _, content = running.ask(path, method, body, **given)
        assert (status, content) == (403, b"")


@pytest.mark.parametrize("headers", [
    {}, {"Origin": "https://example.org"}, {"Origin": "http://127.0.0.1:{port}", "Host": "x.org"}])
def test_events_are_for_the_page_alone(running: Running, headers: dict[str, str]) -> None:
    given = {key: value.format(port=running.port) for key, value in headers.items()}
    status, _, content = running.ask("events", "GET", None, Upgrade="websocket",
                                     Connection="Upgrade", Sec_WebSocket_Version="13",
                                     Sec_WebSocket_Key="dGhlIHNhbXBsZSBub25jZQ==", **given)
    assert (status, content) == (403, b"")


def test_no_path_leaves_the_files_of_the_page(running: Running) -> None:
    for path in ("../private.txt", "..%2fprivate.txt", "%2e%2e/%2e%2e/etc/passwd", "/etc/passwd",
                 "vendor/../../session.py", "vendor/..%5c..%5csession.py", "index.html%00",
                 "tile/image/0/0/../0.png", "tile/map9/0/0/0.png", "tile/map0/99/0/0.png",
                 "tile/private/0/0/0.png", "page/app.js", "vendor/", "..", "session.jsonl",
                 "scan.tif", "call/save", "state/x"):
        status, _, content = running.ask(path)
        assert status in (403, 404, 405), (path, status)
        assert b"private" not in content
        assert b"root:" not in content


def test_a_call_is_json_and_known(running: Running) -> None:
    assert running.ask("call/undo", "POST", {}, Content_Type="text/plain")[0] == 415
    assert running.ask("call/undo", "POST", [1])[0] == 400
    assert running.ask("call/nothing", "POST", {})[0] == 404
    for name, given in (("save", {"name": "../x"}), ("save", {"name": 3}), ("save", {}),
                        ("delete", {"ids": "P01"}), ("paste", {}), ("predict", {"image": "x"}),
                        ("graticule", {"box": [0, 0]}), ("graticule", {"box": [0, 0, 1, "x"]}),
                        ("put", {"id": 7}), ("put", {"kind": []}), ("ground", {"map": None})):
        answer = running.call(name, **given)
        assert ("error" in answer) or answer == {"prediction": None}, (name, given)


def test_the_page_loads_nothing_from_elsewhere(running: Running) -> None:
    status, headers, content = running.ask("")
    assert status == 200
    assert b"<title>termsel app</title>" in content
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "script-src 'self';" in policy
    assert "frame-ancestors 'none'" in policy
    assert not re.search(r"https?:", policy)
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["X-Content-Type-Options"] == "nosniff"
    for path in re.findall(r'(?:src|href)="([^"#]+)"', content.decode()):
        assert path == "data:," or running.ask(path)[0] == 200, path
    for name in ("app.js", "panes.js", "panel.js", "server.js", "style.css", "index.html"):
        text = (PAGE / name).read_text("utf-8")
        assert not re.findall(r"https?://(?!www\.w3\.org)", text), name
        assert not re.search(r"innerHTML|insertAdjacentHTML|document\.write|eval\(", text), name


def test_tiles_are_pictures_of_the_right_place(running: Running, place: Path) -> None:
    from io import BytesIO

    from PIL import Image

    with rasterio.open(place / "scan.tif") as raster:
        pixels = raster.read(1)
    state = json.loads(running.ask("state")[2])
    levels = len(state["setting"]["image"]["resolutions"])
    tile = np.asarray(Image.open(BytesIO(running.ask(f"tile/image/{levels - 1}/1/0.png")[2])))
    np.testing.assert_array_equal(tile[:200, :44, 0], pixels[:, 256:])
    assert not tile[:, 44:, 3].any()
    resolutions = state["setting"]["map"]["resolutions"]
    level = min(range(len(resolutions)), key=lambda i: abs(resolutions[i] - 1.0))
    tile = np.asarray(Image.open(BytesIO(running.ask(f"tile/map0/{level}/0/0.png")[2])))
    np.testing.assert_array_equal(tile[:200, :, 0], pixels[:, :256])


def test_ctrl_c_ends_it_and_the_same_command_goes_on(place: Path, tmp_path: Path) -> None:
    begun = Running("scan.tif", "--map", "ortho.tif", "--out", "again", cwd=place)
    begun.call("put", image=[3.25, 4.5])
    said = begun.end()
    assert begun.process.returncode == 0
    assert "Traceback" not in said
    assert "goes on" in said
    first = Running("scan.tif", "--map", "ortho.tif", "--out", "again", cwd=place)
    first.call("put", image=[7.0, 8.0])
    first.process.kill()  # without any warning
    first.process.communicate()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    second = Running(str(place / "again"), cwd=elsewhere)
    state = json.loads(second.ask("state")[2])
    second.end()
    assert [record["image"] for record in state["records"]] == [[3.25, 4.5], [7.0, 8.0]]
    assert state["setting"]["map"]["rasters"] == ["ortho.tif"]


@pytest.mark.parametrize(("arguments", "said"), [
    ((), "no image is given"), (("none.tif",), "none.tif"), (("scan.tif",), "State it with --crs"),
    (("empty",), "neither a session nor a result"),
    (("scan.tif", "--crs", "EPSG:99999999"), "99999999")])
def test_bad_input_is_one_clear_message(place: Path, arguments: tuple[str, ...], said: str,
                                        monkeypatch: pytest.MonkeyPatch) -> None:
    (place / "empty").mkdir(exist_ok=True)
    monkeypatch.chdir(place)
    with pytest.raises(TermselError) as refused:
        app.main([*arguments, "--no-browser", "--out", "bad"], standalone_mode=False)
    assert said in f"{refused.value.what} {refused.value.hint} {refused.value.file}"
    assert not (place / "bad").exists()  # nothing is left behind
