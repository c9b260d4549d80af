"""A study may name data anywhere, as its author's commands do: a dry run lists it first."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from termsel.cli.main import cli

SECRETS = {
    "passwd": "root:S3CRET:0:0:root:/root:/bin/bash\n",
    "env": "API_KEY=S3CRET\nPASSWORD=S3CRET x, y\n",
    "key.pem": "-----BEGIN KEY-----\nS3CRETS3CRET\n-----END KEY-----\n",
    "conf.json": '{"password": "S3CRET"}\n', "conf.xml": "<a><password>S3CRET</password></a>\n",
    "conf.ini": "[core]\npassword = S3CRET\n", "two.csv": "S3CRET,S3CRET\nS3CRET,S3CRET\n",
    "five.txt": "S3CRET S3CRET S3CRET S3CRET S3CRET\n" * 3, "one": "S3CRET\n",
    "users.csv": "user,password,x,y,z\nadmin,S3CRET,1,2,3\nbob,S3CRET,2,3,4\n",
    "conf.yml": "password: S3CRET\n"}


def _dry(study: Path) -> str:
    return CliRunner().invoke(cli, ["compare", str(study), "--dry-run"]).output


@pytest.mark.parametrize("kind", ["points", "lines", "areas", "rpc", "dem"])
@pytest.mark.parametrize("name", SECRETS)
def test_what_is_no_table_is_not_quoted(tmp_path: Path, name: str, kind: str) -> None:
    secret = tmp_path / "home" / name
    secret.parent.mkdir()
    secret.write_text(SECRETS[name])
    points = tmp_path / "study" / "points.csv"
    points.parent.mkdir()
    points.write_text("id,line,sample,x,y,z\n" + "".join(
        f"p{i},{i * 7 % 5},{i},{i % 7},{i * 3 % 11},\n" for i in range(20)))
    study = points.with_name("study.toml")
    named = f'{kind} = "{secret.as_posix()}"\n'
    study.write_text('problems = ["poly-terms"]\n[[data]]\ncrs = "local"\n' + (
        named if kind in ("points", "lines", "areas") else f'points = "points.csv"\n{named}'))
    text = _dry(study)
    assert "S3CRET" not in text
    assert text.startswith("Reads ")
    assert str(secret) in text
    assert "outside of the folder of the study" in text


def test_a_dry_run_lists_data_before_anything_is_read(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for i in range(3):
        (tmp_path / f"points-{i}.csv").write_text("id\n")
    study = tmp_path / "study.toml"
    study.write_text('[[data]]\npoints = "points-*.csv"\ndem = "points-0.csv"\n')

    def fails(*_: object) -> None:
        raise AssertionError("it was read first")

    monkeypatch.setattr("termsel.studies.compare.data_of", fails)
    text = _dry(study)
    assert text.splitlines()[0] == "Reads 3 files:"
    assert [line.split("/")[-1] for line in text.splitlines()[1:4]] == [
        f"points-{i}.csv" for i in range(3)]


def test_a_block_does_not_quote_what_is_no_table(tmp_path: Path) -> None:
    pytest.importorskip("termsel_block")
    for name, text in SECRETS.items():
        (tmp_path / name).write_text(text)
        for key in ("ties", "points", "rpc", "image", "lines"):
            ties = name if key == "ties" else "ties.csv"
            more = "" if key == "ties" else f'{key} = "{name}"\n'
            (tmp_path / "ties.csv").write_text("id,image,line,sample\n" + "".join(
                f"T{i},{image},{i * 10},{i * i}\n" for i in range(5) for image in "AB"))
            (tmp_path / "block.toml").write_text(
                f'crs = "local"\nties = "{ties}"\n[[image]]\nname = "A"\n{more}'
                '[[image]]\nname = "B"\n')
            done = CliRunner().invoke(cli, ["block", str(tmp_path / "block.toml"), "--out",
                                            str(tmp_path / "out"), "--quiet"])
            assert done.exit_code == 2, done.output
            assert "S3CRET" not in done.output
