"""An estimate in the browser, from Python and from a notebook."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from .._results.estimate import LoadEstimate

HEIGHT = 900  # px of the frame in a notebook


class Exploration:
    """An estimate in the lab, until `close`.

    In a notebook it shows the page where it stands; elsewhere open `address`. As a context manager it closes itself.

    Attributes
    ----------
    address : str
        On this machine alone, with a token that is new at every start.
    """

    def __init__(self, estimate: LoadEstimate, port: int = 0) -> None:
        from .desk import Desk
        from .own import page_of
        from .server import Lab

        self._lab: Any = Lab([page_of(Desk(estimate), given=True)], port).start()
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
        return (f'<iframe src="{address}" title="estimate in the lab" width="100%" height="{HEIGHT}" '
                f'style="border: 1px solid #888"></iframe><p><a href="{address}">in a window of its own</a></p>')  # fmt: skip


def explore(estimate: LoadEstimate, *, browser: bool | None = None, port: int = 0) -> Exploration:
    """See `LoadEstimate.explore`."""
    found = Exploration(estimate, port)
    if browser or (browser is None and not in_notebook()):
        import webbrowser

        try:
            webbrowser.open(found.address)
        except (webbrowser.Error, OSError):  # none here: the address is there all the same
            pass
    return found


def in_notebook() -> bool:
    """Whether a kernel of IPython shows what is returned."""
    import sys

    module = sys.modules.get("IPython")
    shell = None if module is None else module.get_ipython()
    return shell is not None and type(shell).__name__ == "ZMQInteractiveShell"
