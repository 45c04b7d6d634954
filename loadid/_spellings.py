"""How a family takes its settings: as they are written now, and as release 0.1 spelled each of their fields."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from functools import wraps
from typing import Any, TypeVar

from structures.errors import InputError

from .settings import Guards, Setting, pasted

F = TypeVar("F", bound=Callable[..., Any])
FORMER = {"source": "noise_source"}  # field -> argument of release 0.1, where the names differ
LATER = {"variance", "frf", "errors"}  # fields that release 0.1 had not
ARGUMENTS: dict[str, Arguments] = {}  # of every family


class Progress:
    """What a family tells of how far it is: ``progress(fraction, text)``; silent where nobody asked.

    A callback belongs to the process that gave it: a family that is pickled arrives without it.
    """

    def __init__(self, call: Callable[[float, str], None] | None = None) -> None:
        self.call = call

    def __call__(self, fraction: float, text: str) -> None:
        """Hand on how much is done, 0 to 1, and what is being done."""
        if self.call is not None:
            self.call(fraction, text)

    def __reduce__(self) -> tuple[Any, ...]:
        return Progress, ()

    def __deepcopy__(self, memo: dict[int, Any]) -> Progress:
        return self


@dataclass(frozen=True)
class Arguments:
    """How the settings of a family are written, and how they were.

    Parameters
    ----------
    family : str
    defaults : dict
        Argument -> default.
    kinds : dict
        Argument -> its class and the fields, beyond the first, that this family knows.
    codes : dict
        Argument of release 0.1 that is a guard code now -> that code.
    open : bool
        Whether other arguments are passed on.
    """

    family: str
    defaults: Mapping[str, Any]
    kinds: Mapping[str, tuple[type[Setting], tuple[str, ...]]]
    codes: Mapping[str, str]
    open: bool

    @property
    def former(self) -> dict[str, tuple[str, str]]:
        """Argument of release 0.1 -> the argument that holds it now, and its field there."""
        moved = {
            FORMER.get(f, f): (name, f) for name, (_, known) in self.kinds.items() for f in known if f not in LATER
        }
        return {old: home for old, home in moved.items() if old not in self.defaults}

    @property
    def later(self) -> dict[str, tuple[str, str]]:
        """The same of fields that release 0.1 had not: commands and jobs write them one by one, Python does not."""
        return {f: (name, f) for name, (_, known) in self.kinds.items() for f in known if f in LATER}

    @property
    def names(self) -> tuple[str, ...]:
        """Every setting by its single name, as commands and jobs write it."""
        return (*self.defaults, *self.former, *self.later)

    def folded(self, given: Mapping[str, Any], *, single: bool = False) -> tuple[dict[str, Any], list[str]]:
        """The arguments with the former ones put where they belong, and those that were moved in their new writing.

        Parameters
        ----------
        given : mapping
        single : bool
            Fields that release 0.1 had not may stand alone too.

        Raises
        ------
        InputError
            One setting in both spellings, or one that this family does not know.
        TypeError
            A name that is none.
        """
        taken, former = dict(given), self.former | (self.later if single else {})
        parts: dict[str, dict[str, Any]] = {}
        codes: list[str] = []
        for old in [name for name in given if name not in self.defaults]:
            if old in self.codes:
                parts.setdefault("allow", {})
                codes += [self.codes[old]] if taken.pop(old) else []
            elif old in former:
                argument, name = former[old]
                parts.setdefault(argument, {})[name] = taken.pop(old)
            elif not self.open:
                raise TypeError(self._unknown(old))
        for argument, values in parts.items():
            kind, _ = self.kinds[argument]
            first = taken.get(argument, self.defaults.get(argument))
            if isinstance(first, kind) and argument in given:
                raise InputError("one setting in two spellings", where=self.family, found=f"{argument}={first!r} with "
                                 + ", ".join(f"{n}=" for n in given if former.get(n, self.codes.get(n)) is not None),
                                 expected=f"{argument}={kind.__name__}(...) alone")  # fmt: skip
            made = replace(kind.of(first), **values)
            taken[argument] = Guards.of(made).allowing(codes) if argument == "allow" else made
        for argument, (kind, known) in self.kinds.items():
            one = taken.get(argument)
            for name, value in one.said() if isinstance(one, kind) else ():
                if name not in known and name != fields(kind)[0].name:
                    first = fields(kind)[0].name
                    raise InputError(f"{self.family} does not know this setting", where=argument,
                                     found=f"{name}={pasted(value)}"[:80],
                                     expected=f"{kind.__name__}({', '.join((first, *known))})")  # fmt: skip
        return taken, [f"{argument}={_short(taken[argument], values)}" for argument, values in parts.items()]

    def current(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """The arguments as the constructor takes them, with a warning where some are former ones."""
        taken, moved = self.folded(given)
        if moved:
            old = ", ".join(f"{n}=" for n in given if n not in self.defaults and (n in self.codes or n in self.former))
            warnings.warn(f"{self.family}({old}) is the spelling of release 0.1: write {', '.join(moved)}",
                          DeprecationWarning, stacklevel=3)  # fmt: skip
        return taken

    def _unknown(self, name: str) -> str:
        former = self.former
        near = get_close_matches(name, [*self.defaults, *former, *self.codes], n=1)
        text = f"{self.family} has no setting {name!r}"
        if not near:
            return f"{text}; it has {', '.join(self.defaults)}"
        if near[0] in self.codes:
            return f"{text}; did you mean allow=[{self.codes[near[0]]!r}]?"
        if near[0] in former:
            argument, field = former[near[0]]
            return f"{text}; did you mean {argument}={self.kinds[argument][0].__name__}({field}=...)?"
        return f"{text}; did you mean {near[0]!r}?"


def _short(made: Setting, values: Mapping[str, Any]) -> str:
    """A setting as it is written, long values left out."""
    text = repr(made)
    return text if len(text) <= 200 else f"{type(made).__name__}(..., {', '.join(f'{n}=...' for n in values)})"


def takes(codes: Mapping[str, str] | None = None, **kinds: tuple[type[Setting], str]) -> Callable[[F], F]:
    """Constructor whose arguments may be spelled as in release 0.1.

    Parameters
    ----------
    codes : mapping, optional
        Former argument -> guard code that says it now.
    **kinds
        Argument -> its class, and the names of the fields beyond the first that the family knows.
    """

    def decorate(made: F) -> F:
        parameters = [p for p in inspect.signature(made).parameters.values() if p.name != "self"]
        name = made.__qualname__.split(".")[0]
        written = Arguments(
            name,
            {p.name: p.default for p in parameters if p.kind is not p.VAR_KEYWORD},
            {argument: (kind, tuple(known.split())) for argument, (kind, known) in kinds.items()},
            codes or {},
            any(p.kind is p.VAR_KEYWORD for p in parameters),
        )
        ARGUMENTS[name] = written

        @wraps(made)
        def constructor(*args: Any, **given: Any) -> Any:
            return made(*args, **written.current(given))

        return constructor  # type: ignore[return-value]

    return decorate


def folded(family: Callable[..., Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Settings by their single names, as the command line has them, put together as a family takes them.

    Parameters
    ----------
    family : callable
        As `loadid.Deconvolution`, or `loadid.recommend`.
    given : mapping
        ``{"noise": 0.1, "noise_source": "datasheet", "path": "dense"}``, say.

    Raises
    ------
    InputError
        A setting that the family does not know, or one in two spellings.
    TypeError
        A name that is none.
    """
    names = [one.__name__ for one in inspect.getmro(family)] if inspect.isclass(family) else [family.__name__]
    return next(ARGUMENTS[name] for name in names if name in ARGUMENTS).folded(given, single=True)[0]
