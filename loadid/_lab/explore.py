"""An estimate in the browser, from Python and from a notebook."""

from __future__ import annotations

import html
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Self

from structures.errors import InputError

from .contract import Call, Page, Real, Reals, Whole

if TYPE_CHECKING:
    from .._results.estimate import LoadEstimate
    from .shown import Shown

HEIGHT = 900  # px of the frame in a notebook
LAMBDA = Real(0.0, 1e12)  # relative; 0 is the estimate as it was found
LOAD = Whole(0, 100_000)
ESTIMATE = Whole(0, 10**9)
TOGETHER = 8  # pictures that are made ahead in one call, at most


def page_with(shown: Callable[[], Shown], more: dict[str, Call]) -> Page:
    """The page that shows an estimate, and what else it is asked."""

    def of_number(of: int) -> Shown:
        found = shown()
        if found.number != of:
            raise InputError("another load has been found since, in another window", where="lab",
                             found="an older one", expected="one load at a time",
                             hint="load this page again, or find the load again")  # fmt: skip
        return found

    return Page(
        "own",
        "Your own data",
        "A log and a model: what was recorded, what the data can tell, and the load at any lambda.",
        "loadid._lab",
        "files/own.html",
        {
            "found": Call(lambda: shown().found()),
            "picture": Call(
                lambda of, lam, load: of_number(of).picture(lam, load), {"of": ESTIMATE, "lam": LAMBDA, "load": LOAD}
            ),
            "ahead": Call(
                lambda of, lams, load: of_number(of).ahead(lams, load),
                {"of": ESTIMATE, "lams": Reals(LAMBDA.low, LAMBDA.high, TOGETHER, 1), "load": LOAD},
            ),
            "at": Call(lambda of, lam: of_number(of).at(lam), {"of": ESTIMATE, "lam": LAMBDA}),
            "save": Call(lambda of, lam: of_number(of).save(lam), {"of": ESTIMATE, "lam": LAMBDA}),
            **more,
        },
    )


class Exploration:
    """An estimate in the lab, until `close`.

    In a notebook it shows the page where it stands; elsewhere open `address`. As a context manager it closes itself.

    Attributes
    ----------
    address : str
        On this machine alone, with a token that is new at every start.
    """

    def __init__(self, estimate: LoadEstimate, port: int = 0) -> None:
        from .server import Lab
        from .shown import Shown

        shown = Shown(estimate)
        state = {"model": None, "log": None, "found": True, "given": True}
        page = page_with(lambda: shown, {"state": Call(lambda: state)})
        self._lab: Any = Lab([page], port).start()
        self.address: str = self._lab.page("own")

    def close(self) -> None:
        """End the server; once is enough."""
        lab, self._lab = self._lab, None
        if lab is not None:
            lab.close()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()

    def __repr__(self) -> str:
        return f"<estimate in the lab: {self.address if self._lab is not None else 'closed'}>"

    def _repr_html_(self) -> str:
        if self._lab is None:
            return "<p>This exploration is closed.</p>"
        address = html.escape(self.address, quote=True)
        return (
            f'<iframe src="{address}" title="estimate in the lab" width="100%" height="{HEIGHT}"></iframe>'
            f'<p><a href="{address}">in a window of its own</a></p>'
        )


def explore(estimate: LoadEstimate, *, browser: bool | None = None, port: int = 0) -> Exploration:
    """See `LoadEstimate.explore`."""
    found = Exploration(estimate, port)
    if browser or (browser is None and not in_notebook()):
        import webbrowser
        from contextlib import suppress

        with suppress(webbrowser.Error, OSError):  # none here: the address is there all the same
            webbrowser.open(found.address)
    return found


def in_notebook() -> bool:
    """Whether a kernel of IPython shows what is returned."""
    import sys

    module = sys.modules.get("IPython")
    shell = None if module is None else module.get_ipython()
    return shell is not None and type(shell).__name__ == "ZMQInteractiveShell"
