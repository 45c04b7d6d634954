"""Plans of the command line: TOML tables whose keys and values are checked one by one."""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from structures import _toml
from structures.errors import InputError

SHOWN, LONGEST_LIST = 8, 16  # keys of a table that are named, the nearest first, where it has more than so many


class PlanReader:
    """The values of a plan, checked one by one.

    Parameters
    ----------
    where : str
        Path of the plan, for messages.
    names : mapping of str to sequence of str
        Kind of table -> its keys; ``"plan"`` is the whole.
    """

    def __init__(self, where: str, names: Mapping[str, Sequence[str]]) -> None:
        self.where, self.names = where, names

    def known(self, tree: Mapping[str, Any], kind: str, place: str) -> None:
        """Nothing, if every key is one of its table.

        Raises
        ------
        InputError
        """
        for name in tree:
            if name not in self.names[kind]:
                near = difflib.get_close_matches(name, self.names[kind], n=SHOWN, cutoff=0.5)
                listed = list(dict.fromkeys([*near, *self.names[kind]]))
                more = "" if len(listed) <= LONGEST_LIST else f", ... ({len(listed)} in all)"
                hint = f"did you mean {near[0]!r}?" if near else "leave it out"
                raise InputError("there is no such key", where=self._at(place), found=repr(name),
                                 expected=", ".join(listed[: SHOWN if more else None]) + more,
                                 hint=hint)  # fmt: skip

    def _at(self, place: str) -> str:
        return place if place == self.where else f"{self.where}, {place}"

    def refused(self, place: str, found: Any, expected: str) -> NoReturn:
        """A value that is none.

        Raises
        ------
        InputError
        """
        raise InputError("no such value", where=self._at(place), found=repr(found)[:80], expected=expected)

    def table(self, tree: Mapping[str, Any], name: str) -> dict[str, Any]:
        """A table of the plan, empty where it is left out."""
        found = tree.get(name, {})
        if not isinstance(found, dict):
            keys = ", ".join(f"{key} = ..." for key in self.names.get(name, ())[:SHOWN])
            self.refused(name, found, f"a table [{name}]" + (f", or {name} = {{{keys}}}" if keys else ""))
        return found

    def text(self, tree: Mapping[str, Any], name: str, place: str) -> str:
        """A text that must be there."""
        found = tree.get(name)
        if found is None:
            raise InputError(f"{name!r} is missing", where=self._at(place), expected="a text",
                             hint=f'add {name} = "..."')  # fmt: skip
        if not isinstance(found, str) or not found.strip():
            self.refused(f"{name} of {place}", found, "a text")
        return found

    def file(self, tree: Mapping[str, Any], name: str, place: str, folder: Path) -> Path:
        """A file that must be there; its path counts from the folder of the plan.

        Raises
        ------
        InputError
        """
        path = folder / self.text(tree, name, place)
        if not path.is_file():
            raise InputError(f"there is no such {name}", where=self._at(place), found=str(path),
                             expected=f"a {name} file",
                             hint="check the path, which counts from the folder of this file")  # fmt: skip
        return path

    def assets(self, tree: Mapping[str, Any], needs: str) -> list[dict[str, Any]]:
        """The tables ``[[asset]]``, each under what ``[every]`` says, with ``{name}`` replaced.

        Raises
        ------
        InputError
            None at all, one without a name, two of one name, a key that is none.
        """
        every = self.table(tree, "every")
        self.known(every, "asset", "[every]")
        listed = tree.get("asset", [])
        if not isinstance(listed, list) or not listed or not all(isinstance(one, dict) for one in listed):
            raise InputError("the plan names no asset", where=self.where, found=type(listed).__name__,
                             expected=f"[[asset]] tables with {needs}")  # fmt: skip
        names = [self.text(one, "name", "[[asset]]") for one in listed]
        twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
        if twice is not None:
            raise InputError("two assets have one name", where=self.where, found=repr(twice),
                             expected="a name for each")  # fmt: skip
        found = []
        for name, one in zip(names, listed, strict=True):
            self.known(one, "asset", f"[[asset]] {name}")
            found.append({key: named(value, name) for key, value in {**every, **one}.items()})
        return found


def read(path: str | os.PathLike[str], what: str = "plan") -> dict[str, Any]:
    """The tables of a file; `what` it is called in messages.

    Raises
    ------
    InputError
        No such file, no TOML.
    """
    try:
        return _toml.load(Path(path), f"the {what} is no TOML", "mend the line")
    except OSError as error:
        raise InputError(f"the {what} cannot be read", where=str(path), found=error.strerror or str(error),
                         hint="check the path") from None  # fmt: skip


def named(value: Any, name: str) -> Any:
    """A value with ``{name}`` replaced in its texts."""
    if isinstance(value, list):
        return [named(one, name) for one in value]
    return value.replace("{name}", name) if isinstance(value, str) else value


def is_number(value: Any) -> bool:
    """Whether a value of a plan is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < float("inf")
