"""Pack the plugin as a file that QGIS installs.

    python plugins/qgis-termsel/package.py [FILE.zip]
    python plugins/qgis-termsel/package.py [FILE.zip] --for-repository [--email ADDRESS]
        [--repository URL] [--tracker URL] [--homepage URL]

The second form is for the repository of QGIS plugins, which takes no plugin without these four.
What no option states comes from pyproject.toml next to this file: email from `authors`, the others
from the `repository`, `issues` and `homepage` of `[project.urls]`.
"""

from __future__ import annotations

import argparse
import re
import sys
import tomllib
import zipfile
from pathlib import Path
from urllib.parse import urlsplit

FOLDER = Path(__file__).with_name("qgis_termsel")
PROJECT = Path(__file__).with_name("pyproject.toml")
WANTED = {"email": "authors = [{ name = ..., email = ... }]", "repository": "urls.repository",
          "tracker": "urls.issues", "homepage": "urls.homepage"}


def stated_metadata(project: dict) -> dict[str, str]:
    """Return the metadata of the plugin that the table [project] of pyproject.toml states.

    Keys are email, tracker, repository and homepage, as in metadata.txt; those that the table does
    not state are left out.
    """
    # Keys of [project.urls] may have capitals.
    urls = {name.lower(): url for name, url in project.get("urls", {}).items()}
    emails = [author["email"] for author in project.get("authors", []) if "email" in author]
    metadata = {"email": next(iter(emails), ""), "tracker": urls.get("issues", ""),
                **{name: urls.get(name, "") for name in ("repository", "homepage")}}
    return {name: text for name, text in metadata.items() if text}


def metadata_faults(metadata: dict[str, str]) -> list[str]:
    """Return a sentence on each entry that the repository of QGIS plugins would refuse.

    `metadata` should have the keys of `WANTED`. The list is empty if it is complete and valid.
    """
    sentences = [f"{name} is missing: give --{name}, or {where_stated} in {PROJECT.name}."
                 for name, where_stated in WANTED.items() if name not in metadata]
    for name, text in metadata.items():
        url = urlsplit(text)
        if name == "email":
            if not re.fullmatch(r"[^@\s]+@[^@\s]+\.[^@\s]+", text):
                sentences.append(f"email {text!r} is no address.")
        elif url.scheme not in ("http", "https") or not url.netloc or len(text.split()) != 1:
            sentences.append(f"{name} {text!r} is no address of a page, such as https://...")
    return sentences


def pack(target: Path, metadata: dict[str, str]) -> None:
    """Write the plugin's files to a zip file, with `metadata` added to its metadata.txt."""
    further_lines = "".join(f"{name}={text}\n" for name, text in metadata.items())
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as packed:
        # Sorted, so that the same files are always in the same order.
        for file in sorted(FOLDER.rglob("*")):
            if not file.is_file() or "__pycache__" in file.parts:
                continue
            name = str(file.relative_to(FOLDER.parent).as_posix())
            if file.name == "metadata.txt":
                packed.writestr(name, file.read_text(encoding="utf-8").rstrip() + "\n"
                                + further_lines)
            else:
                packed.write(file, name)


def main(arguments: list[str] | None = None) -> int:
    """Pack the plugin as the command line says, and return the exit code.

    It is 0, or 2 if the file cannot be written or, with --for-repository, would be refused.
    """
    parser = argparse.ArgumentParser(description="Pack the plugin as a file that QGIS installs.")
    parser.add_argument("target", nargs="?", type=Path, default=Path("qgis_termsel.zip"))
    parser.add_argument("--for-repository", action="store_true",
                        help="state what the repository of QGIS plugins asks for")
    for name in WANTED:
        parser.add_argument(f"--{name}")
    options = vars(parser.parse_args(arguments))
    metadata = stated_metadata(tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"])
    # Options come before what the project file states.
    metadata.update({name: options[name] for name in WANTED if options[name]})
    problems = metadata_faults(metadata)
    if options["for_repository"] and problems:
        print("Error:", *problems, sep="\n  ", file=sys.stderr)
        return 2
    try:
        pack(options["target"], metadata)
    except OSError as error:
        print(f"Error: {options['target']} cannot be written: {error.strerror}.", file=sys.stderr)
        return 2
    print(f"Written: {options['target']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
