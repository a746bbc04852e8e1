"""Edits and names of parts, as people write them and as the library takes them."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any, Optional, Union
from unicodedata import category

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._meshes import MOST, Path, as_path, listed, packed, real, unmasked, whole

Edits = Union[Path, Mapping[str, Any], Sequence[Mapping[str, Any]]]
Names = Union[Path, Mapping[int, str], Sequence[str]]

FORMAT = {"format": "nystrom-stream edits", "version": 1}


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The fields of an object: of two of a name, `json` keeps the last."""
    fields = dict(pairs)
    if len(fields) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"duplicate field `{next(name for name in names if names.count(name) > 1)}`")
    return fields


def as_edits(edits: Any) -> dict[str, Any]:
    """The content of a file of edits as a dict: from a path, such a dict, or a list of edits."""
    if isinstance(edits, (str, bytes, os.PathLike)):
        # Some editors begin each file with a byte order mark.
        path = as_path("edits", edits)
        with open(path, encoding="utf-8-sig") as file:
            try:
                edits = json.load(file, object_pairs_hook=_once)
            except ValueError as error:
                raise ValueError(f"{path}: not a file of edits: {error}") from None
    if isinstance(edits, Mapping) and "edits" in edits:
        return {**FORMAT, **edits}
    if isinstance(edits, Mapping):
        edits = [edits]
    if not isinstance(edits, Sequence) or not all(isinstance(edit, Mapping) for edit in edits):
        raise TypeError('edits: give a path, or a list such as [{"edit": "split", "at": [0.5, 0.1, 0.2], "into": 3}]')
    return {**FORMAT, "edits": list(edits)}


def text_of(edits: Mapping[str, Any]) -> str:
    """The text of a file of edits; NumPy arrays and numbers are accepted."""
    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return dict(value)
        if hasattr(value, "tolist"):
            return value.tolist()
        raise TypeError(f"a {type(value).__name__} is neither a place, a number nor a text")

    try:
        return json.dumps(edits, default=plain, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise type(error)(f"edits: {error}") from None


def as_hints(hints: Union[ArrayLike, str, None], mesh: _native.Mesh) -> Optional[NDArray[np.uint32]]:
    """One value per face as uint32: from an array, or from a property of the mesh's file."""
    if hints is None:
        return None
    if isinstance(hints, str):
        return mesh.face_property(hints)
    hints = listed("hints", unmasked("hints", hints, 0))
    if hints.ndim != 1 or len(hints) != mesh.faces or not np.issubdtype(hints.dtype, np.integer) or (hints < 0).any():
        raise ValueError(f"hints: give one integer per face, 0 or more; there are {mesh.faces} faces")
    if (hints > MOST).any():
        raise ValueError(f"hints: {hints.max()} exceeds 32 bits")
    # A copy: edits of the cut take them again, whatever becomes of the array.
    return packed(hints, np.uint32).copy()


def read_names(names: Any, parts: Optional[int] = None) -> Union[dict[int, str], list[str]]:
    """Names of parts, which must be lines of text, of `parts` parts if that is known: from a dict by part, a list, or the path of a
    table."""
    if isinstance(names, (str, bytes, os.PathLike)):
        # By part: it adds to the names that edits gave, as with the program.
        names = {part: name for part, name in enumerate(_native.read_names(as_path("names", names))) if name}
    by_part = hasattr(names, "keys")
    if isinstance(names, (set, frozenset)):
        raise TypeError("names: a set has no order; give a list, or a dict by part")
    if not by_part and not hasattr(names, "__iter__"):
        raise TypeError(f"names: {names!r}; give a list, a dict by part, or the path of a table")
    told = {whole("names", part): name for part, name in (dict(names).items() if by_part else enumerate(names))}
    for part, name in told.items():
        if not by_part and not name:
            continue
        # Control characters and halves of surrogate pairs.
        if not isinstance(name, str) or any(category(letter) in ("Cc", "Cs") for letter in name):
            raise ValueError(f"names: {name!r} is not a line of text")
        if parts is not None and part >= parts:
            raise ValueError(f"names: there is no part {part}; the {parts} parts are counted from 0")
    return told if by_part else [name or "" for name in told.values()]


def as_names(names: Any, parts: int, before: Sequence[str] = ()) -> list[str]:
    """A name per part, "" where it has none; `names` is a list, or a dict by part or the path of a table, which add to `before`."""
    names = read_names(names, parts)
    by_part = isinstance(names, dict)
    all_names = [*(before if by_part else names), *[""] * parts][:parts]
    for part, name in names.items() if by_part else ():
        all_names[part] = name
    return all_names


def started(options: Mapping[str, Any]) -> dict[str, Any]:
    """The cut that edits of a cut with `options` start from, as in a file of edits."""
    parts = json.loads(options["params"])["parts"]
    if isinstance(parts["count"], dict) and "exactly" in parts["count"]:
        return {"parts": parts["count"]["exactly"]}
    return {"detail": parts["detail"]} if parts["detail"] else {}


def protects(edits: Mapping[str, Any]) -> bool:
    """Whether some of the edits protect parts: those of the cut that the edits are made on."""
    return any(edit.get("edit") == "protect" for edit in edits["edits"])


def started_from(options: Mapping[str, Any], edits: Mapping[str, Any]) -> dict[str, Any]:
    """`options` of a cut, with the number of parts that `edits` start from, if given there."""
    params = json.loads(options["params"])
    if edits.get("parts") is not None:
        params["parts"].update(count={"exactly": whole("parts", edits["parts"], 1)}, detail=0.0)
    elif edits.get("detail") is not None:
        params["parts"].update(count=json.loads(_native.default_params())["parts"]["count"], detail=real("detail", edits["detail"]))
    return {**options, "params": json.dumps(params)}
