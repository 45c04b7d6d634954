"""``loadid lab``: pages in a browser that show what the package's own code does."""

from __future__ import annotations

import os
import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace, RawDescriptionHelpFormatter
from typing import TYPE_CHECKING

from . import Command, UsageError, add_log_options, emit, one_record, say, settings

if TYPE_CHECKING:
    from .._lab.contract import Page

SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")  # one is set where a browser has a place to open
EXAMPLES = """\
examples:
  open the lab in the browser; Ctrl-C ends it:
    loadid lab
  on a machine without a browser, at a port of your choice:
    loadid lab --no-browser --port 8123

  your own data: the record, the load, and the load at any lambda:
    loadid lab log.csv model.h5

The server listens on 127.0.0.1 alone, and answers only who has the address that it prints: the token in it is new at
every start. Nothing is fetched from the network.
"""


def port(text: str) -> int:
    """A port, 0 for any that is free."""
    if not (text.isascii() and text.isdecimal() and int(text) < 65536):
        raise ArgumentTypeError(f"{text!r} is no port: a whole number from 0 to 65535")
    return int(text)


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("log", metavar="LOG", nargs="?", help="log to look at, with the model behind it")
    parser.add_argument("model", metavar="MODEL", nargs="?", help="model file, as for loadid identify --model")
    parser.add_argument("--port", type=port, default=0, metavar="N", help="port to listen on; default any that is free")
    parser.add_argument("--no-browser", action="store_true", help="only print the address")
    add_log_options(parser)


def _run(args: Namespace) -> int:
    from .._lab.pages import pages
    from .._lab.server import Lab

    own = None if args.log is None else _own(args)
    lab = Lab(pages() if own is None else [own if page.name == own.name else page for page in pages()], args.port)
    address = lab.address if own is None else lab.page(own.name)
    try:
        emit(args, {"address": address}, f"the lab is at {address} (Ctrl-C ends it)")
        sys.stdout.flush()
        if not args.no_browser:
            _open(address)
        lab.run()
    except KeyboardInterrupt:
        say("the lab has ended", aside=True)
    finally:
        lab.http.server_close()
    return 0


def _own(args: Namespace) -> Page:
    """The page of one's own data, with the files that are named on it."""
    if args.model is None:
        raise UsageError("LOG is looked at with the model behind it: loadid lab LOG MODEL (see loadid lab --help)")
    from .._lab.desk import Desk
    from .._lab.own import page_of

    desk = Desk()
    desk.read_model(args.model)
    desk.read_log(args.log, record=one_record(args) or "", **settings(args))
    return page_of(desk)


def _open(address: str) -> None:
    """Show the address in a browser, where there is one; one that would take the terminal is none."""
    import webbrowser

    screen = sys.platform in ("darwin", "win32") or any(os.environ.get(name) for name in SCREENS)
    try:
        shown = screen and webbrowser.open(address)
    except (webbrowser.Error, OSError):
        shown = False
    if not shown:
        say("no browser was found: open the address yourself", aside=True)


command = Command("lab", "pages in a browser: see what inversion does, and learn the trade", _configure, _run)
