"""The compiled module, which the package's own functions call; what it has may change."""

from typing import Any

__version__: str

def __getattr__(name: str) -> Any: ...
