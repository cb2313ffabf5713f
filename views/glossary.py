"""The joint's symbols in words, for readers without the equations."""

from __future__ import annotations

import re
from pathlib import Path

import yaml

SYMBOLS: dict[str, str] = yaml.safe_load(Path(__file__).with_name("glossary.yaml").read_text(encoding="utf-8"))
"""Meaning of each symbol of joint descriptions, causes and tables."""
_ORDERS = {
    "A": "amplitude of the gear's kinematic error, {} per turn of the wave generator",
    "φ": "phase of the gear's kinematic error, {} per turn of the wave generator",
}
# Single letters are also words, and names with underscores can be read as words.
_IN_TEXT = sorted((s for s in SYMBOLS if len(s) > 1 and "_" not in s and s != "RMS"), key=len, reverse=True)
_PATTERN = re.compile(r"(?<!\w)(?:" + "|".join(re.escape(s) for s in _IN_TEXT) + r"|[Aφ]\d+(?:\.\d+)?′*)(?!\w)")


def meaning(symbol: str) -> str:
    """Return a symbol in words; empty for an unknown one."""
    order = symbol[1:].rstrip("′")
    if symbol[:1] in _ORDERS and order.replace(".", "").isdigit():
        text = _ORDERS[symbol[0]].format("once" if order == "1" else f"{order} times")
        return f"{text}; a quarter of a period further" if symbol.endswith("′") else text
    return SYMBOLS.get(symbol, "")


def pieces(text: str) -> list[tuple[str, str]]:
    """Split a text at symbols; return pieces with the meaning of symbols, empty for the rest."""
    found, at = [], 0
    for match in _PATTERN.finditer(text):
        found += [(text[at : match.start()], ""), (match.group(), meaning(match.group()))]
        at = match.end()
    return [(piece, words) for piece, words in [*found, (text[at:], "")] if piece]
