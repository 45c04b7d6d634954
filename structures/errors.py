"""The two errors of the three packages: wrong input, and a load that the data cannot determine."""

from __future__ import annotations


class InputError(ValueError):
    """Wrong input: what is wrong, where, what was found, what was expected, and what to do.

    Parameters
    ----------
    what : str
        One sentence that names the fault.
    where : str, optional
        File, argument, channel or line in which it was found.
    found, expected : object, optional
        What was there, and what should have been there.
    hint : str, optional
        What the user does next.
    code : str, optional
        Guard code (``"LID-E104"``) when a guard refused.
    """

    def __init__(
        self,
        what: str,
        *,
        where: str = "",
        found: object = None,
        expected: object = None,
        hint: str = "",
        code: str = "",
    ) -> None:
        self.what, self.where, self.found, self.expected, self.hint, self.code = (
            what,
            where,
            found,
            expected,
            hint,
            code,
        )
        parts = [f"{where}: {what}" if where else what]
        if found is not None:
            parts.append(f"found: {found}")
        if expected is not None:
            parts.append(f"expected: {expected}")
        if hint:
            parts.append(f"what to do: {hint}")
        super().__init__((f"[{code}] " if code else "") + "; ".join(parts))


class NotIdentifiable(Exception):
    """The data or the layout cannot determine the load.

    Parameters
    ----------
    what : str
        What cannot be determined, with the number that shows it.
    advice : str
        What to add or to change.
    code : str
        Guard code, for example ``"LID-E306"``; naming it in ``allow=`` overrides the refusal where that makes sense.
    """

    def __init__(self, what: str, *, advice: str, code: str) -> None:
        self.what, self.advice, self.code = what, advice, code
        super().__init__(f"[{code}] {what}; what to do: {advice}")
