"""Where the level of the noise comes from: a kind that decides, and a text for people."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

from structures.errors import InputError, shown

# kind: what is printed where nothing else is said
KINDS = {
    "datasheet": "data sheet",  # of the sensors, or declared with them
    "repeatability": "repeatability",  # scatter of repeated measurements, or a covariance of them
    "pre_trigger": "quiet segment",  # the part of the record before its response
    "quiet": "unloaded record",  # another record, or other frames, without a load
    "residual": "residual",  # what a model leaves of data that it was fitted to
    "stated": "a guess of the user",  # a number, and nothing known on how it was found
    "unknown": "not known",  # no level: the data tell it, or nobody does
}
MEASURED = ("datasheet", "repeatability", "pre_trigger", "quiet", "residual")  # the level was found by somebody


@dataclass(frozen=True)
class NoiseSource:
    """Where a noise level comes from.

    Parameters
    ----------
    kind : {"datasheet", "repeatability", "pre_trigger", "quiet", "residual", "stated", "unknown"}
        Data sheet; scatter of repeated measurements; the record before its response; an unloaded record; what a model
        leaves of its data; a number without an origin; no level.
    text : str, optional
        For people; default a word for the kind. Nothing is decided by it.
    white : bool
        The noise is known to be white.

    Raises
    ------
    InputError
        Another kind, or a text that is none.
    """

    kind: str
    text: str = ""
    white: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.kind, str) or self.kind not in KINDS or not isinstance(self.text, str):
            raise InputError("no source of a noise level", where="noise_source",
                             found=shown(self.kind if isinstance(self.text, str) else self.text),
                             expected=f"a kind ({', '.join(KINDS)}) and a text")  # fmt: skip
        object.__setattr__(self, "white", bool(self.white))
        if not self.text:
            object.__setattr__(self, "text", KINDS[self.kind] + (", white" if self.white else ""))

    def __str__(self) -> str:
        return self.text

    @property
    def measured(self) -> bool:
        """Whether somebody has found the level, rather than stated a number."""
        return self.kind in MEASURED

    @property
    def facts(self) -> dict[str, Any]:
        """Text and kind, as they stand among the facts of a result."""
        return {"noise_source": self.text, "noise_kind": self.kind}

    @classmethod
    def of(cls, given: NoiseSourceLike) -> NoiseSource | None:
        """What a caller gave as the source: a kind, a kind and a text, or a text of its own, which is ``stated``.

        Parameters
        ----------
        given : NoiseSource, str, (str, str) or None
            Texts that release 0.1 documented or printed have the kind that they had there (`WRITTEN`).

        Raises
        ------
        InputError
            Something else.
        """
        if given is None or isinstance(given, cls):
            return given
        if isinstance(given, str):
            if not given:
                return None
            return cls(given) if given in KINDS else WRITTEN.get(given) or cls("stated", given)
        if isinstance(given, tuple | list) and len(given) == 2:
            return cls(*given)
        raise InputError("no source of a noise level", where="noise_source", found=shown(given),
                         expected=f"a kind ({', '.join(KINDS)}), (kind, text), or a text")  # fmt: skip


NoiseSourceLike: TypeAlias = NoiseSource | str | tuple[str, str] | None
NOT_KNOWN = NoiseSource("unknown")
STATED = NoiseSource("stated")
# texts by which release 0.1 told sources apart: those of its documentation, of its results and of its advice
WRITTEN = {
    text: NoiseSource(kind, text, white=white)
    for text, kind, white in (
        ("data sheet", "datasheet", False),
        ("data sheet (declared with the sensors)", "datasheet", False),
        ("data sheet (stated with the channels)", "datasheet", False),
        ("repeatability", "repeatability", False),
        ("covariance", "repeatability", False),
        ("covariance of the interpolated markers", "repeatability", False),
        ("quiet segment", "pre_trigger", False),
        ("unloaded record", "quiet", False),
        ("unloaded frames", "quiet", False),
        ("residual", "residual", False),
        ("residual power", "residual", False),
        ("roughness", "residual", False),
        ("roughness of the load spectrum that each sensor gives alone", "residual", False),
        ("likelihood of the innovations", "residual", False),
        ("what the fit of the best criterion leaves", "residual", False),
        ("a guess of the user", "stated", False),
        ("white", "stated", True),
        ("not known", "unknown", False),
    )
}
