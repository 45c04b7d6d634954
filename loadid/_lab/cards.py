"""Page of the lab: questions and answers to learn the trade by, repeated at growing distances."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from typing import Any

from structures.errors import one_of

from .contract import Call, Page, Text
from .facts import stated


@cache
def table() -> dict[str, Any]:
    """Topics by name, and cards by key, as they are written."""
    found = tomllib.loads(files(__package__).joinpath("files/cards.toml").read_text("utf-8"))
    return {"topics": found["topics"], "cards": {card["key"]: card for card in found["card"]}}


def cards() -> dict[str, Any]:
    """Topics by name, and the key, topic and question of every card."""
    asked = [{"key": key, "topic": card["topic"], "question": stated(card["question"])}
             for key, card in table()["cards"].items()]  # fmt: skip
    return {"topics": table()["topics"], "cards": asked}


def answer(key: str) -> dict[str, str]:
    """Answer of a card, with the numbers that the package computes.

    Raises
    ------
    InputError
        No such card.
    """
    return {"answer": stated(table()["cards"][one_of("no such card", key, table()["cards"], where="key")]["answer"])}


page = Page(
    "cards", "Flashcards",
    "Questions of the trade, repeated at growing distances; what you know stays in this browser.",
    __package__, "files/cards.html",
    {"cards": Call(cards), "answer": Call(answer, {"key": Text(60)})},
)  # fmt: skip
