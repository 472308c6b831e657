"""The cache of compiled code."""

from pathlib import Path

import sitl
from sitl.flight import compiled
from sitl.flight.flight_model import advance


def test_cached_code_depends_on_every_compiled_source():
    """A change of control.py must not leave flight_model.advance, which contains its code, as it was."""
    folder = Path(sitl.__file__).parent
    with_compiled = {file for file in folder.rglob("*.py") if "\n@compiled\n" in file.read_text()}
    assert with_compiled == {folder / "flight" / name for name in compiled.SOURCES}
    assert advance._cache._cache_file._source_stamp == compiled.stamp()
