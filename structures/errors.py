"""The two errors of the three packages: wrong input, and a load that the data cannot determine."""

from __future__ import annotations

from collections.abc import Callable

from .advice import on_command_line


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
        super().__init__(self._told(str))

    @property
    def command(self) -> str:
        """The text in the words of the command line."""
        return self._told(on_command_line)

    def _told(self, said: Callable[[object], str]) -> str:
        what = said(self.what)
        parts = [f"{self.where}: {what}" if self.where else what]
        if self.found is not None:
            parts.append(f"found: {said(self.found)}")
        if self.expected is not None:
            parts.append(f"expected: {said(self.expected)}")
        if self.hint:
            parts.append(f"what to do: {said(self.hint)}")
        return (f"[{self.code}] " if self.code else "") + "; ".join(parts)


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

    @property
    def command(self) -> str:
        """The text in the words of the command line."""
        return f"[{self.code}] {on_command_line(self.what)}; what to do: {on_command_line(self.advice)}"
