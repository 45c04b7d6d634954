"""The command line: finds the subcommands, turns errors into one line and an exit code."""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, NoReturn

from structures._advice import on_command_line
from structures.errors import InputError, NotIdentifiable

from . import __version__
from ._commands import Command, UsageError

__all__ = ["commands", "main"]

GROUP = "loadid.commands"
DONE, USAGE, BAD_INPUT, REFUSED = 0, 2, 3, 4
_OWN = ("demo", "info", "check", "calibrate", "modes", "identify", "track", "batch")


class _Parser(argparse.ArgumentParser):
    """Refuses wrong words by an error of ours; learns its arguments where it is the one that is asked."""

    configure: Callable[[argparse.ArgumentParser], None] | None = None

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        configure, self.configure = self.configure, None
        if configure is not None:
            configure(self)
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message} (see {self.prog} --help)")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Returns
    -------
    int
        0 done, 2 usage, 3 bad input, 4 refused as not identifiable.
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    if argv[:1] == ["--version"]:  # before anything else is imported
        print(f"loadid {__version__}")
        return DONE
    as_json = "--json" in argv or "--json-full" in argv
    try:
        args = _parser().parse_args(argv)
        with _Log(args.log_level):
            return int(args.run(args))
    except UsageError as error:
        return _fail(as_json, USAGE, {"what": str(error)}, str(error))
    except SystemExit as error:  # --help
        return error.code if isinstance(error.code, int) else DONE
    except InputError as error:
        fields = {k: getattr(error, k) for k in ("what", "where", "found", "expected", "hint", "code")}
        return _fail(as_json, BAD_INPUT, fields, error.command)
    except NotIdentifiable as error:
        return _fail(as_json, REFUSED, {k: getattr(error, k) for k in ("what", "advice", "code")}, error.command)
    except BrokenPipeError:  # the reader of a pipe has gone; nothing more can be said to it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except OSError as error:
        return _fail(as_json, BAD_INPUT, {"what": str(error)}, str(error))
    except KeyboardInterrupt:
        return _fail(as_json, 130, {"what": "interrupted"}, "interrupted")


def commands() -> dict[str, Command]:
    """All subcommands, by name: those of the entry points, or this package's own where it is not installed."""
    found: dict[str, Command] = {}
    named = set()
    for point in entry_points(group=GROUP):
        named.add(point.name)
        try:
            found[point.name] = point.load()
        except Exception as error:  # a broken command of another package must not take the others down
            print(f"loadid: the command {point.name!r} ({point.value}) is left out: {error}", file=sys.stderr)
    if not any(name in named for name in _OWN):
        print(
            "loadid: not installed, so its registered commands cannot be read (python -m pip install -e .); "
            "only its own commands are known",
            file=sys.stderr,
        )
    missing = [name for name in _OWN if name not in named]  # also of an install in place that is older than its tree
    return found | {name: import_module(f"._commands.{name}", __package__).command for name in missing}


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="loadid",
        description="Reconstruct applied loads, with their uncertainty, from measured responses.",
        epilog="exit codes: 0 done, 2 usage, 3 bad input, 4 refused as not identifiable",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"loadid {__version__}")
    levels = ("debug", "info", "warning", "error")
    parser.add_argument("--log-level", choices=levels, default="warning", help="what to log on standard error")
    listed = parser.add_subparsers(metavar="COMMAND", required=True, parser_class=_Parser)
    for name, command in commands().items():
        sub = listed.add_parser(name, help=command.help, description=command.help, allow_abbrev=False)
        sub.add_argument("--json", action="store_true", help="print one JSON value; errors as JSON on standard error")
        sub.configure = command.configure
        sub.set_defaults(run=command.run)
    return parser


class _Log:
    """Log of the three packages on standard error while a command runs."""

    def __init__(self, level: str) -> None:
        self.level = level.upper()
        self.handler = logging.StreamHandler()
        self.handler.setFormatter(logging.Formatter("%(name)s %(levelname)s: %(message)s"))
        self.loggers = [logging.getLogger(name) for name in ("structures", "loadid", "tactile")]

    def __enter__(self) -> None:
        self.before = [logger.level for logger in self.loggers]
        for logger in self.loggers:
            logger.addHandler(self.handler)
            logger.setLevel(self.level)

    def __exit__(self, *exc: object) -> None:
        for logger, level in zip(self.loggers, self.before, strict=True):
            logger.removeHandler(self.handler)
            logger.setLevel(level)


def _fail(as_json: bool, code: int, fields: dict[str, Any], text: str) -> int:
    if as_json:
        given = {k: v for k, v in fields.items() if v is not None and str(v) != ""}
        known = {k: on_command_line(v) if not isinstance(v, int | float) else v for k, v in given.items()}
        kind = {USAGE: "usage", BAD_INPUT: "bad input", REFUSED: "not identifiable"}.get(code, "interrupted")
        print(json.dumps({"error": {"kind": kind, "exit": code, **known}}, ensure_ascii=False), file=sys.stderr)
    else:
        print(f"loadid: {' '.join(text.split())}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
