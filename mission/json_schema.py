"""JSON Schema of the bus messages, in the subset that Foxglove's reader of MCAP files accepts.

That reader wants `"type": "object"` at the root, a plain `type` for every entry of `properties`, and knows neither
`$ref` nor alternatives nor arrays of arrays. What it does not know (a matrix, a field that may be null) is described
under `patternProperties`, which it skips: the schema stays true of every message, and the values still show in its raw
message panel.
"""

from typing import Any

import msgspec

from bus.messages import Message

Schema = dict[str, Any]


def json_schema(message: type[Message]) -> Schema:
    """The schema of one message, without references, as written into `flight.mcap`."""
    root = msgspec.json.schema(message)
    definitions = root["$defs"]
    return _inline(definitions[message.__name__], definitions)


def _inline(schema: Schema, definitions: Schema) -> Schema:
    if "$ref" in schema:
        return _inline(definitions[schema["$ref"].rsplit("/", 1)[-1]], definitions)
    if "anyOf" in schema:
        return {"anyOf": [_inline(choice, definitions) for choice in schema["anyOf"]]}
    if "enum" in schema:
        return schema | {"type": "integer" if all(isinstance(value, int) for value in schema["enum"]) else "string"}
    if schema.get("type") == "object":
        return _object(schema, definitions)
    if "prefixItems" in schema:  # our tuples all hold one type
        length = len(schema["prefixItems"])
        return {
            "type": "array",
            "items": _inline(schema["prefixItems"][0], definitions),
            "minItems": length,
            "maxItems": length,
        }
    if "items" in schema:
        return schema | {"items": _inline(schema["items"], definitions)}
    return schema


def _object(schema: Schema, definitions: Schema) -> Schema:
    fields = {name: _inline(field, definitions) for name, field in schema.get("properties", {}).items()}
    plain = {name: field for name, field in fields.items() if _plain(field)}
    rest = {f"^{name}$": field for name, field in fields.items() if not _plain(field)}
    return schema | {"properties": plain} | ({"patternProperties": rest} if rest else {})


def _plain(field: Schema) -> bool:
    return "type" in field and (field["type"] != "array" or field["items"].get("type", "array") != "array")
