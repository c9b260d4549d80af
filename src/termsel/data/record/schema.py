"""The JSON Schema of result.json, generated from the types of its parts."""

from __future__ import annotations

import ast
import inspect
from typing import Any

import msgspec

from termsel.data.record.figures import RecordPart
from termsel.data.record.record import RESULT_SCHEMA, Record


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of result.json.

    Types and ranges are those that reading holds a record to; descriptions are the docstrings of
    the fields.
    """
    (root,), definitions = msgspec.json.schema_components(
        [Record], ref_template="#/$defs/{name}")
    of_name = {record_class.__name__: record_class for record_class in _all_subclasses(RecordPart)}
    for name, definition in definitions.items():
        definition.pop("title")
        definition["description"] = (of_name[name].__doc__ or "").partition("\n")[0]
        # Each field's description is put first, as that is what people read first.
        docs = _field_descriptions(of_name[name])
        for key, content in definition["properties"].items():
            definition["properties"][key] = {"description": docs[key], **content}
    root_schema = definitions.pop(root["$ref"].rpartition("/")[2])
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "$id": RESULT_SCHEMA,
            "title": "termsel result", **root_schema, "$defs": definitions}


def _all_subclasses(kind: type[RecordPart]) -> list[type[RecordPart]]:
    """Return all direct and indirect subclasses of a kind of part."""
    classes: list[type[RecordPart]] = []
    for subclass in kind.__subclasses__():
        classes += [subclass, *_all_subclasses(subclass)]
    return classes


def _field_descriptions(kind: type[RecordPart]) -> dict[str, str]:
    """Return the docstrings of all fields of a part of the record, by their keys in JSON.

    Inherited fields are among them. Line breaks become spaces.
    """
    (body,) = ast.parse(inspect.getsource(kind)).body
    assert isinstance(body, ast.ClassDef)
    keys = dict(zip(kind.__struct_fields__, kind.__struct_encode_fields__, strict=True))
    by_key: dict[str, str] = {}
    for base in kind.__bases__:
        if base is not RecordPart:
            by_key |= _field_descriptions(base)
    # The docstring of a field is the expression that follows it in the body of the class.
    for field, doc in zip(body.body, body.body[1:], strict=False):
        # Constants of the class are no fields.
        if (isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
                and field.target.id in keys):
            assert isinstance(doc, ast.Expr)
            assert isinstance(doc.value, ast.Constant)
            text = inspect.cleandoc(str(doc.value.value))
            by_key[keys[field.target.id]] = text.replace("\n", " ")
    return by_key
