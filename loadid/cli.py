"""The command line: finds the subcommands, turns errors into one line and an exit code."""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, NoReturn

from structures._advice import did_you_mean, on_command_line
from structures.errors import InputError, NotIdentifiable

from . import __version__
from ._commands import Bar, Command, UsageError, printable

__all__ = ["commands", "main", "parsers"]

log = logging.getLogger(__name__)

GROUP = "loadid.commands"
DONE, USAGE, BAD_INPUT, REFUSED = 0, 2, 3, 4
LEVELS = ("debug", "info", "warning", "error")
_OWN = (
    "demo", "info", "check", "model", "calibrate", "modes", "design", "identify", "compare", "vibration", "track",
    "learn", "batch", "serve", "convert", "guide", "doctor", "lab",
    "completion",
)  # fmt: skip


class _Parser(argparse.ArgumentParser):
    """Refuses wrong words by an error of ours, with the word that was meant; learns its arguments where it is asked."""

    configure: Callable[[argparse.ArgumentParser], None] | None = None

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        if self.configure is not None:  # a command: all that it is given is its own
            self.learn()
            self._known(list(sys.argv[1:] if args is None else args))
        found, rest = super().parse_known_args(args, namespace)
        if rest:
            self.error(self._unknown(rest))
        return found, rest

    @property
    def arguments(self) -> tuple[argparse.Action, ...]:
        """Its arguments, positional ones and options."""
        return tuple(self._actions)

    def learn(self) -> None:
        """Add the arguments of its command, once."""
        configure, self.configure = self.configure, None
        if configure is not None:
            configure(self)

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message} (see {self.prog} --help)")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        words = [str(c) for c in action.choices]
        what = "command" if action.nargs == argparse.PARSER else "choice"
        more = did_you_mean(str(value), words)
        raise argparse.ArgumentError(action, f"there is no {what} {value!r} (choose from {', '.join(words)}){more}")

    def _known(self, args: list[str]) -> None:
        """Nothing, if every option is one; else it is named before any is missed."""
        given = args[: args.index("--")] if "--" in args else args
        words = [w.partition("=")[0] for w in given if w.startswith("--")]
        wrong = [w for w in words if w not in self._option_string_actions]
        if wrong:
            self.error(self._unknown(wrong))

    def _unknown(self, rest: list[str]) -> str:
        word = next((w for w in rest if w.startswith("-")), None)
        if word is None:
            return f"unrecognized arguments: {' '.join(rest)}"
        options = [o for o in self._option_string_actions if o.startswith("--")]
        return f"there is no option {word}{did_you_mean(word, options)}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Returns
    -------
    int
        0 done, 1 answered but not to be used, 2 usage, 3 bad input, 4 refused as not identifiable.
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    if argv[:1] == ["--version"]:  # before anything else is imported
        print(f"loadid {__version__}")
        return DONE
    as_json = not {"--json", "--json-full", "--log-json"}.isdisjoint(argv)
    try:
        args = _parser().parse_args(argv)
        with _Log(args.log_level, as_json=args.log_json, hushed=args.hushed):
            return _run(args)
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


def _run(args: argparse.Namespace) -> int:
    """Run the command, and log that it begins and how it ends."""
    begun = time.monotonic()
    log.info("%s begins", args.named)
    try:
        code = int(args.run(args))
    except BaseException as error:
        log.info("%s fails after %.2f s: %s", args.named, time.monotonic() - begun, type(error).__name__)
        raise
    log.info("%s ends with exit code %d after %.2f s", args.named, code, time.monotonic() - begun)
    return code


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


def _parser() -> _Parser:
    parser = _Parser(
        prog="loadid",
        description="Reconstruct applied loads, with their uncertainty, from measured responses.",
        epilog="exit codes: 0 done, 1 answered but not to be used, 2 usage, 3 bad input, 4 refused as not identifiable",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"loadid {__version__}")
    _add_common(parser, json=False, log_level=None, log_json=False, hushed=False)
    listed = parser.add_subparsers(metavar="COMMAND", required=True, parser_class=_Parser)
    for name, command in commands().items():
        sub = listed.add_parser(name, help=command.help, description=command.help, allow_abbrev=False,
                                conflict_handler="resolve")  # fmt: skip
        _add_common(sub)
        sub.configure = command.configure
        sub.set_defaults(run=command.run, named=name)
    return parser


def parsers() -> dict[str, _Parser]:
    """The parser of every command with its arguments, by name, and that of the whole under ``""``."""
    whole = _parser()
    listed = next(action.choices for action in whole.arguments if action.nargs == argparse.PARSER)
    found: dict[str, _Parser] = {"": whole, **dict(listed or {})}
    for parser in found.values():
        parser.learn()
    return found


def _add_common(parser: argparse.ArgumentParser, **defaults: Any) -> None:
    """Options that may stand before the command and after it; after it they say nothing where they are left out."""
    group = parser.add_argument_group("how it answers")

    def add(*names: str, **settings: Any) -> None:
        dest = settings.pop("dest", names[-1].strip("-").replace("-", "_"))
        group.add_argument(*names, dest=dest, default=defaults.get(dest, argparse.SUPPRESS), **settings)

    add("--json", action="store_true", help="print one JSON value; errors as JSON on standard error")
    add("-q", "--quiet", dest="hushed", action="store_true", help="print nothing but errors")
    add("--log-level", choices=LEVELS, help="what to log on standard error; default warning, with --quiet error")
    add("--log-json", action="store_true", help="log, and say errors, as lines of JSON")


class _Log:
    """Log of the three packages on standard error while a command runs; hushed, or as JSON, without progress."""

    def __init__(self, level: str | None, *, as_json: bool, hushed: bool) -> None:
        self.level, self.hushed = (level or ("error" if hushed else "warning")).upper(), hushed or as_json
        self.handler = logging.StreamHandler()
        plain = LogLines("%(name)s %(levelname)s: %(message)s")
        self.handler.setFormatter(_JsonLines() if as_json else plain)
        self.loggers = [logging.getLogger(name) for name in ("structures", "loadid", "tactile")]

    def __enter__(self) -> None:
        self.before = [logger.level for logger in self.loggers]
        self.drawn, Bar.hushed = Bar.hushed, self.hushed
        for logger in self.loggers:
            logger.addHandler(self.handler)
            logger.setLevel(self.level)

    def __exit__(self, *exc: object) -> None:
        Bar.hushed = self.drawn
        for logger, level in zip(self.loggers, self.before, strict=True):
            logger.removeHandler(self.handler)
            logger.setLevel(level)


class LogLines(logging.Formatter):
    """Text that a terminal only shows."""

    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


class _JsonLines(logging.Formatter):
    """One JSON value a line: seconds since 1970, level, logger, message."""

    def format(self, record: logging.LogRecord) -> str:
        line = {"time": round(record.created, 6), "level": record.levelname.lower(), "logger": record.name,
                "message": record.getMessage()}  # fmt: skip
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return printable(json.dumps(line, ensure_ascii=False))


def _fail(as_json: bool, code: int, fields: dict[str, Any], text: str) -> int:
    if as_json:
        given = {k: v for k, v in fields.items() if v is not None and str(v) != ""}
        known = {k: on_command_line(v) if not isinstance(v, int | float) else v for k, v in given.items()}
        kind = {USAGE: "usage", BAD_INPUT: "bad input", REFUSED: "not identifiable"}.get(code, "interrupted")
        said = json.dumps({"error": {"kind": kind, "exit": code, **known}}, ensure_ascii=False)
    else:
        said = f"loadid: {' '.join(text.split())}"
    print(printable(said), file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
