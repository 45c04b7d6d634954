"""``loadid completion``: what a shell completes, written from the parsers."""

from __future__ import annotations

import argparse
import re
import shlex
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Sequence
from dataclasses import dataclass

from .._inverse import penalties
from . import NONE, Command, choice, emit, penalty

SHELLS = ("bash", "zsh", "fish")
EXAMPLES = """\
examples:
  bash, for this shell; in ~/.bashrc for every one:     eval "$(loadid completion bash)"
  zsh, in ~/.zshrc:                                     eval "$(loadid completion zsh)"
  fish:  loadid completion fish > ~/.config/fish/completions/loadid.fish
"""


@dataclass(frozen=True)
class ShellOption:
    """An option of a command: its spellings, its help, whether a value follows, and the words that it may be."""

    names: tuple[str, ...]
    help: str
    valued: bool
    words: tuple[str, ...]


@dataclass(frozen=True)
class Words:
    """What may follow a command: its options, and the words of its first argument where these are given."""

    help: str
    options: tuple[ShellOption, ...]
    first: tuple[str, ...]


def words() -> dict[str, Words]:
    """Commands with their options, as the parsers have them; the options of the whole under ``""``."""
    from ..cli import parsers

    found = parsers()
    listed = {name: _words(parser.arguments, parser.description or "") for name, parser in found.items()}
    return {**listed, "": Words("", listed[""].options, tuple(n for n in found if n))}


def _words(arguments: Sequence[argparse.Action], description: str) -> Words:
    shown = [a for a in arguments if a.help is not argparse.SUPPRESS]
    options = tuple(
        ShellOption(tuple(a.option_strings), " ".join((a.help or "").replace("%(default)s", str(a.default)).split()),
               a.nargs != 0, _choices(a))
        for a in shown if a.option_strings
    )  # fmt: skip
    first = next((a for a in shown if not a.option_strings and a.choices and a.dest != argparse.SUPPRESS), None)
    return Words(description, options, () if first is None else _choices(first))


def _choices(action: argparse.Action) -> tuple[str, ...]:
    if action.choices is not None:
        return tuple(str(c) for c in action.choices)
    if action.type is choice:
        from .._inverse.rules import RULES

        return tuple(RULES)
    return (*penalties.ORDER, NONE) if action.type is penalty else ()


# -- the shells --------------------------------------------------------------------------------------------------------
def bash(known: dict[str, Words]) -> str:
    """A function for bash; file names are left to the shell."""
    cases = [
        f"      {_either(name, option)}) words={shlex.quote(' '.join(option.words))}; given=1 ;;"
        for name, some in known.items()
        for option in some.options
        if option.valued
    ]
    options = [f"      {name or 'none'}) words={_quoted(some)} ;;" for name, some in known.items()]
    listed = {name: some.first for name, some in known.items() if name and some.first}
    first = [f"      {name}) words={shlex.quote(' '.join(some))} ;;" for name, some in listed.items()]
    names = "|".join(n for n in known if n)
    before = "|".join(o for option in known[""].options if option.valued for o in option.names)
    return f"""\
_loadid() {{
  local cur="${{COMP_WORDS[COMP_CWORD]}}" prev="${{COMP_WORDS[COMP_CWORD-1]}}"
  local command="" words="" given="" word last=""
  for word in "${{COMP_WORDS[@]:1:COMP_CWORD-1}}"; do
    case "$last" in
      {before}) last=""; continue ;;
    esac
    last="$word"
    case "$word" in
      {names}) command="$word"; break ;;
    esac
  done
  COMPREPLY=()
  case "$command:$prev" in
{_lines(cases)}
  esac
  if [ -z "$given" ]; then
    case "$cur" in
    -*) case "${{command:-none}}" in
{_lines(options)}
      esac ;;
    *) case "${{command:-none}}" in
      none) words={shlex.quote(" ".join(known[""].first))} ;;
{_lines(first)}
      esac ;;
    esac
  fi
  COMPREPLY=($(compgen -W "$words" -- "$cur"))
}}
complete -o default -F _loadid loadid
"""


def zsh(known: dict[str, Words]) -> str:
    """The function for bash, by zsh's own bridge."""
    return f"autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n{bash(known)}"


def fish(known: dict[str, Words]) -> str:
    """Lines of ``complete``."""
    names = [n for n in known if n]
    lines = [f"complete -c loadid -n __fish_use_subcommand -f -a {n} -d {_said(known[n].help)}" for n in names]
    for name, some in known.items():
        when = f"'__fish_seen_subcommand_from {name}'" if name else "__fish_use_subcommand"
        for option in some.options:
            spelled = " ".join(f"-l {o[2:]}" if o.startswith("--") else f"-s {o[1:]}" for o in option.names)
            value = " -r" if option.valued else ""
            value += f" -f -a {shlex.quote(' '.join(option.words))}" if option.words else ""
            lines.append(f"complete -c loadid -n {when} {spelled}{value} -d {_said(option.help)}")
        if name and some.first:
            lines.append(f"complete -c loadid -n {when} -f -a {shlex.quote(' '.join(some.first))}")
    return "\n".join(lines) + "\n"


def _either(name: str, option: ShellOption) -> str:
    return "|".join(f"{name}:{spelled}" for spelled in option.names)


def _quoted(some: Words) -> str:
    return shlex.quote(" ".join(name for option in some.options for name in option.names))


def _lines(lines: list[str]) -> str:
    return "\n".join(lines) or "      '') ;;"


def _said(text: str) -> str:
    """The first part of a help, as fish quotes it."""
    short = re.split(r"[;:(]", text)[0].strip()[:60]
    return "'" + short.replace("\\", "\\\\").replace("'", "\\'") + "'"


WRITERS = {"bash": bash, "zsh": zsh, "fish": fish}


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help=", ".join(SHELLS))


def _run(args: Namespace) -> int:
    script = WRITERS[args.shell](words())
    emit(args, {"shell": args.shell, "script": script}, script)
    return 0


command = Command("completion", "what a shell completes after loadid: commands, options, rules", _configure, _run)
