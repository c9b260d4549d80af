"""Mutations that know the structure of a file: its numbers, cells, lines, JSON, XML and bytes."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from random import Random
from typing import Any
from xml.etree import ElementTree

NUMBERS = (
    "0", "-0", "1", "-1", "1e308", "-1e308", "1e-320", "1e200", "1e50", "1e16", "9" * 25,
    "9" * 5000, "nan", "inf", "-inf", "1_000", "0x10", "1,5", "1.5.2", "", " ", "१२", "1e", "+",
    "-", "1e9999", "2147483648", "9223372036854775808", "180", "-180", "90", "360.0001", "1D5",
    "1 2")
TEXTS = (
    "", " ", "#", "# crs: EPSG:32631", '"', '""', "'", ",", ";", "\t", "\n", "\r", "\0", "\ufeff",
    "\x1b[31m\x1b]0;x\x07", "[/nope]", "\u202e", "\ud800", "\x9b", "=1+1", "@x", "-x", "+x", "日本",
    "a" * 300, "a" * 5000, "../x", "/vsicurl/http://127.0.0.1:9/x", "http://127.0.0.1:9/x", "NULL",
    "None", "true", "EPSG:4326", "EPSG:999999", "local", "%s%n", "{}", "[[", "<a>", "&amp;",
    "control", "check", "independent", "off", "P0", "P1", "id", "x", "línea")
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1e308, 1e200, 10**25, float("nan"), float("inf"), "", "x", "\0",
    "\x1b[31m", "\ud800", [], {}, [[]], [1, 2, 3], {"a": 1}, 1.5, -0.0, "1e5", "nan")

_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_]\w*")


def mutated(content: bytes, random: Random) -> bytes:
    """Return a content with one to four mutations of its kind.

    Parameters
    ----------
    content : bytes
    random : random.Random
    """
    head = content[:200].lstrip()
    text = b"\0" not in content
    own = _json if head.startswith((b"{", b"[")) else _xml if head.startswith(b"<") else None
    for _ in range(random.choice((1, 1, 1, 1, 2, 3))):
        ways: tuple[Callable[[bytes, Random], bytes], ...] = (
            (own, own, _token, _token, _line, _bytes) if own else
            (_token, _token, _token, _cells, _cells, _line, _line, _bytes) if text else
            (_bytes, _bytes, _bytes, _token))
        content = random.choice(ways)(content, random)
    return content


def _encoded(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")


def _hostile(random: Random) -> bytes:
    return _encoded(random.choice(random.choice((NUMBERS, TEXTS))))


def _token(content: bytes, random: Random) -> bytes:
    """Replace a number or a word by a hostile one, or by another of the file."""
    pattern, others = random.choice(((_NUMBER, NUMBERS), (_NUMBER, NUMBERS), (_WORD, TEXTS)))
    found = list(pattern.finditer(content))
    if not found:
        return _bytes(content, random)
    place = random.choice(found)
    new = random.choice(found)[0] if random.random() < 0.2 else _encoded(random.choice(others))
    return content[:place.start()] + new + content[place.end():]


def _cells(content: bytes, random: Random) -> bytes:
    """Change the cells of a row, or one cell of every row."""
    lines = content.split(b"\n")
    comma = max((b",", b";", b"\t", b" "), key=content.count)
    column, new, way = random.randrange(8), _hostile(random), random.randrange(4)

    def changed(line: bytes) -> bytes:
        cells = line.split(comma)
        if line.startswith(b"#") or column >= len(cells):
            return line
        if way == 0:
            cells[column] = new
        elif way == 1:
            cells[column] = b'"' + cells[column].replace(b'"', b'""') + new + b'"'
        elif way == 2:
            del cells[column]
        else:
            cells[column] = cells[0]
        return comma.join(cells)

    if random.random() < 0.3:
        return b"\n".join(map(changed, lines))
    row = random.randrange(len(lines))
    lines[row] = changed(lines[row])
    return b"\n".join(lines)


def _line(content: bytes, random: Random) -> bytes:
    """Remove, repeat, move or insert lines."""
    lines = content.split(b"\n")
    row = random.randrange(len(lines))
    way = random.randrange(5)
    if way == 0:
        del lines[row]
    elif way == 1:
        lines.insert(random.randrange(len(lines)), lines[row])
    elif way == 2:
        lines.insert(row, _hostile(random))
    elif way == 3:
        lines[row:row + 1] *= random.choice((2, 50))
    else:
        random.shuffle(lines)
    return b"\n".join(lines)


def _bytes(content: bytes, random: Random) -> bytes:
    """Change bytes, whatever they mean."""
    place = random.randrange(len(content) + 1)
    end = min(len(content), place + random.choice((1, 2, 8, 200)))
    way = random.randrange(9)
    if way == 0:
        return content[:place]
    if way == 1:
        return content[:place] + content[end:]
    if way == 2:
        return content[:place] + random.randbytes(random.choice((1, 2, 8))) + content[place:]
    if way == 3:
        return content[:place] + random.randbytes(end - place) + content[end:]
    if way == 4:
        return content[:place] + _hostile(random) + content[place:]
    if way == 5:
        return content[:place] + content[place:end] * random.choice((2, 100)) + content[end:]
    if way == 6:
        return random.choice((b"\xef\xbb\xbf", b"\xff\xfe", b"\0", b"\n" * 9, b" ")) + content
    if way == 7:
        return content.replace(b"\n", random.choice((b"\r\n", b"\r", b"", b"\n\n")))
    return content.decode("latin-1").encode(random.choice(("utf-16", "utf-8")))


def _json(content: bytes, random: Random) -> bytes:
    """Replace, remove, repeat or nest a part of JSON."""
    try:
        whole = json.loads(content)
    except (ValueError, RecursionError):
        return _bytes(content, random)
    places: list[tuple[Any, Any]] = []
    waiting = [whole]
    while waiting:
        one = waiting.pop()
        items = list(one.items() if isinstance(one, dict) else enumerate(one))
        places += [(one, key) for key, _ in items]
        waiting += [value for _, value in items if isinstance(value, dict | list)]
    if not places:
        return _bytes(content, random)
    inside, key = random.choice(places)
    way = random.randrange(6)
    if way == 0:
        del inside[key]
    elif way == 1:
        other, where = random.choice(places)
        inside[key] = json.loads(json.dumps(other[where]))
    elif way == 2:
        for _ in range(random.choice((1, 3, 900))):
            inside[key] = [inside[key]]
    elif way == 3 and isinstance(inside, list):
        inside += inside[key:key + 1] * random.choice((1, 30))
    elif way == 4 and isinstance(inside, dict):
        inside[random.choice(TEXTS)] = inside.pop(key)
    else:
        inside[key] = random.choice((*VALUES, random.choice(TEXTS)))
    try:
        text = json.dumps(whole, ensure_ascii=random.random() < 0.5)
    except RecursionError:  # nested several times
        return content
    return _encoded(text)


def _xml(content: bytes, random: Random) -> bytes:
    """Change text, attribute or tag of an element; remove, repeat or nest it."""
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, LookupError, ValueError):
        return _bytes(content, random)
    parents = [(parent, child) for parent in root.iter() for child in parent]
    if not parents:
        return _bytes(content, random)
    parent, child = random.choice(parents)
    way = random.randrange(7)
    if way == 0:
        parent.remove(child)
    elif way == 1:
        parent.append(child)
    elif way == 2:
        parent.remove(child)
        random.choice([one for one in root.iter() if one is not child]).append(child)
    elif way == 3 and child.attrib:
        child.set(random.choice(list(child.attrib)), _clean(random))
    elif way == 4 and child.attrib:
        del child.attrib[random.choice(list(child.attrib))]
    elif way == 5:
        child.tag = random.choice([one.tag for one in root.iter()])
    else:
        child.text = _clean(random)
    encoding = random.choice(("utf-8", "utf-8", "latin-1", "utf-16", "gb2312"))
    try:
        return ElementTree.tostring(root, encoding, xml_declaration=random.random() < 0.5)
    except (RecursionError, UnicodeError):
        return content


def _clean(random: Random) -> str:
    return _hostile(random).decode("utf-8", "replace")
