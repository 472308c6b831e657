"""Files that people write: YAML (or JSON, which is YAML) in, one mapping out."""

import re
import sys
from collections.abc import Hashable, Iterable
from pathlib import Path
from typing import Any

import yaml

STDIN = Path("-")


class YamlError(ValueError):
    """A file that is not one mapping; one line naming file and fault."""


class _Loader(yaml.SafeLoader):
    """YAML in which a key given twice is a mistake, and `1e3` a number as in YAML 1.2."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        lines: dict[str, int] = {}
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                line = key.start_mark.line + 1
                if key.value in lines:
                    raise YamlError(f"{key.value}: given twice, in lines {lines[key.value]} and {line}")
                lines[key.value] = line
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def read_mapping(path: Path, fields: Iterable[str]) -> dict[Any, Any]:
    """The mapping in a file, or on standard input for `-`; `fields` are named when it holds none. Raises YamlError."""
    try:
        text = sys.stdin.read() if path == STDIN else path.read_text(encoding="utf-8")
        mapping = yaml.load(text, _Loader)
    except YamlError as error:
        raise YamlError(f"{path}: {error}") from error
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise YamlError(f"{path}: {why}") from error
    except (yaml.YAMLError, RecursionError) as error:
        raise YamlError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(mapping, dict):
        raise YamlError(f"{path}: must hold a mapping of fields ({', '.join(fields)})")
    return mapping
