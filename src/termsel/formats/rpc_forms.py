"""RPCs in nested files: JSON, Orthority's YAML, and XML or tags with an RPC for each band.

Names of numbers differ between them: "rowNum", "row_num" and "line_num_coeff" are the same twenty
coefficients. A file may have the RPCs of several bands or images, each by its name.

References
----------
EnMAP metadata as EnPT reads them (github.com/GFZ/enpt): product/navigation/RPC/bandID. JSON of
rpcm (github.com/centreborelli/rpcm), as with the Data Fusion Contest 2019, and of VisSat. YAML of
Orthority (orthority.readthedocs.io), RPC parameter file.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Any
from xml.etree import ElementTree

import msgspec
import numpy as np

from termsel.core.errors import TermselError
from termsel.data.record.record import RpcNumbers
from termsel.data.rpc import Rpc

Items = dict[str, str]
"""Numbers as text by the names of GDAL's RPC domain."""

DEEPEST = 20
"""Levels of a nested file; known ones have four."""

_COORDINATES = {"row": "LINE", "line": "LINE", "col": "SAMP", "column": "SAMP", "samp": "SAMP",
                "sample": "SAMP", "lat": "LAT", "latitude": "LAT", "lon": "LONG", "long": "LONG",
                "longitude": "LONG", "alt": "HEIGHT", "altitude": "HEIGHT", "height": "HEIGHT"}
_NUMBERS = {"off": "OFF", "offset": "OFF", "scale": "SCALE", "num": "NUM_COEFF",
            "den": "DEN_COEFF"}
_COEFFICIENT_NAME = re.compile("({})({})(?:coeffs?|coefs?)?([0-9]*)".format(*(
    "|".join(sorted(words, key=len, reverse=True)) for words in (_COORDINATES, _NUMBERS))))
_ERRORS = {"errbias": "ERR_BIAS", "errrand": "ERR_RAND"}
_IS_RPC = {"LINE_NUM_COEFF", "SAMP_DEN_COEFF"}


def rpcs_of_tree(tree: object) -> dict[str, Items]:
    """Return the items of each RPC in nested dictionaries, by the name of its image or band.

    The name is that of the nearest key above it; where several RPCs would have one name, theirs are
    all keys that lead to them.
    """
    rpcs: dict[str, Items] = {}
    for path, values in _find_dictionaries(tree, ()):
        items = _items_by_gdal_name(values)
        if items.keys() >= _IS_RPC:
            # A key "rpc" names no image.
            name = next((key for key in reversed(path) if key.lower() != "rpc"), "")
            rpcs[name if name not in rpcs else "/".join(path)] = items
    return rpcs


def rpcs_of_xml(root: ElementTree.Element) -> dict[str, Items]:
    """Return the RPCs of bands in XML, by the numbers of the bands."""
    rpcs = {}
    for band in root.iter("bandID"):
        items = _items_by_gdal_name({element.tag: element.text for element in band})
        if items.keys() >= _IS_RPC:
            rpcs[band.get("number", "")] = items
    return rpcs


def rpc_of_tags(tags: Mapping[str, str]) -> Items:
    """Return the items of the RPC in the tags of a band; {} without one."""
    items = _items_by_gdal_name(tags)
    return items if items.keys() >= _IS_RPC else {}


def rpc_of_result(tree: object) -> Rpc | None:
    """Return the vendor's RPC that a run was given, from the tree of its result.json.

    Returns None if it was given none. Raises TermselError if its numbers were changed.
    """
    # Any JSON may be given: each level is looked at before it is used.
    data = tree.get("data") if isinstance(tree, dict) and "schema" in tree else None
    numbers = data.get("rpc") if isinstance(data, dict) else None
    if numbers is None:
        return None
    try:
        return Rpc.from_numbers(msgspec.convert(numbers, RpcNumbers))
    except msgspec.ValidationError as error:
        raise TermselError(f"the RPC in this result was changed: {error}",
                           hint="Give the vendor's file of the RPC.") from error


def tree_of_json(text: str) -> object:
    """Return the tree of a text of JSON; None if it is not JSON."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


def tree_of_yaml(text: str) -> dict[str, Any]:
    """Return dictionaries of the YAML that Orthority writes: blocks of keys, and lists.

    Lists are in brackets, or have an item a line after a dash. A text of another kind gives {}.
    """
    tree: dict[str, Any] = {}
    levels: list[tuple[int, dict[str, Any]]] = [(-1, tree)]
    parent = tree
    key = ""
    for line in _whole_lines(text):
        if line.lstrip().startswith("- "):
            if parent.get(key) == {}:
                # The key seemed to begin a block of keys, but begins a list.
                parent[key] = []
                levels.pop()
            if not isinstance(parent.get(key), list):
                return {}
            parent[key].append(line.strip().removeprefix("- ").strip())
            continue
        name, colon, text_of_value = line.partition(":")
        key = name.strip().strip("\"'")
        if not colon or not key or text_of_value[:1].strip():
            return {}
        indent = len(name) - len(name.lstrip(" "))
        value = text_of_value.strip()
        # A line that is indented no more than a block ends it.
        while levels[-1][0] >= indent:
            levels.pop()
        parent = levels[-1][1]
        if value.startswith("["):
            parent[key] = value.strip("[] ").split(",")
        elif value:
            parent[key] = value
        else:
            parent[key] = {}
            levels.append((indent, parent[key]))
    return tree


def largest_difference(rpcs: Mapping[str, Rpc], name: str) -> float:
    """Return the largest distance between the image positions of one RPC and of the others [px].

    It is that within the box of ground and image in which the RPC `name` is valid; 0 where no
    distance is known.
    """
    rpc = rpcs[name]
    # A lattice over the cube within which an RPC is valid: offset +- scale along each axis.
    steps = np.array(list(product(np.linspace(-1.0, 1.0, 5), repeat=3)))
    ground = steps * rpc.ground_scale + rpc.ground_offset
    image = rpc.project(ground)
    inside = (np.abs(image - rpc.image_offset) <= rpc.image_scale).all(axis=1)
    visible_ground = ground[inside]
    distances = [np.linalg.norm(other_rpc.project(visible_ground) - image[inside], axis=1)
                 for other_rpc in rpcs.values()]
    return float(np.nanmax(distances, initial=0.0))


def _whole_lines(text: str) -> Iterator[str]:
    """Yield the lines of YAML, those of a list in brackets as one, without comments."""
    joined: list[str] = []
    open_brackets = 0
    for line in text.splitlines():
        content = line.split(" #")[0].rstrip()
        if not content.strip() or content.lstrip().startswith(("#", "---")):
            continue
        joined.append(content.strip() if joined else content)
        open_brackets += content.count("[") - content.count("]")
        if open_brackets <= 0:
            yield " ".join(joined)
            joined = []
            open_brackets = 0
    if joined:
        yield " ".join(joined)


def _find_dictionaries(tree: object, path: tuple[str, ...],
                       ) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
    """Yield the dictionaries of a tree, with the keys that lead to them.

    Raises TermselError for a tree that is more than `DEEPEST` levels deep: a small file can nest
    without end.
    """
    if len(path) > DEEPEST:
        raise TermselError("the file is nested too deeply for one of RPCs",
                           hint="Give the file of the RPC.")
    if isinstance(tree, dict):
        yield path, tree
        for key, value in tree.items():
            yield from _find_dictionaries(value, (*path, str(key)))
    elif isinstance(tree, list):
        for number, value in enumerate(tree):
            if isinstance(value, dict | list):
                yield from _find_dictionaries(value, (*path, str(number)))


def _items_by_gdal_name(values: Mapping[str, Any]) -> Items:
    """Return the numbers of an RPC by GDAL's names, in whatever spelling they come.

    Names are compared by their letters alone. Coefficients come as a list, as a text, or numbered
    one by one, which are joined in their order.
    """
    items: Items = {}
    for key, value in values.items():
        # "lineNumCoef", "LINE_NUM_COEFF" and "line num coeff" have the same letters.
        letters = re.sub(r"[^a-z0-9]", "", str(key).lower())
        # In YAML a key without a value seems to begin a block.
        if letters in _ERRORS and not isinstance(value, dict):
            items[_ERRORS[letters]] = str(value)
        match = _COEFFICIENT_NAME.fullmatch(letters)
        if match is None:
            continue
        name = f"{_COORDINATES[match[1]]}_{_NUMBERS[match[2]]}"
        if isinstance(value, list):
            items[name] = " ".join(map(str, value))
        elif match[3]:
            items[f"{name}_{match[3]}"] = str(value)
            items.setdefault(name, "")
        else:
            items[name] = str(value)
    # Coefficients that are numbered have an item each.
    return {name: text for name, text in items.items() if text} | {
        name: _join_lines(items, name) for name, text in items.items() if not text}


def _join_lines(items: Items, name: str) -> str:
    """Return the values of NAME_1, NAME_2, ... in the order of their numbers, as one text."""
    # By their numbers, as 10 comes before 2 in the order of text.
    keys = [key for key in items if key.startswith(f"{name}_")]
    return " ".join(items[key] for key in sorted(keys, key=_number_of))


def _number_of(key: str) -> int:
    """Return the number at the end of a key such as LINE_NUM_COEFF_10."""
    return int(key.rpartition("_")[2])
