"""What ``--json`` prints is as docs/json-schema.json says."""

import json
from typing import Any

import jsonschema
from support.builders import REPOSITORY

SCHEMA = json.loads((REPOSITORY / "docs" / "json-schema.json").read_text(encoding="utf-8"))


def check(text: str, name: str) -> Any:
    """What a text says that is as the schema describes it."""
    value = json.loads(text)
    jsonschema.validate(value, SCHEMA | {"$ref": f"#/$defs/{name}"})
    return value
