"""Text from outside, made harmless: names of files, joints and sites may hold anything.

A terminal obeys escape sequences, and marks of direction turn a line round; a line break in a name
makes two lines of one message.
"""

from __future__ import annotations

import unicodedata

# Controls, marks of direction and other invisible ones, halves of pairs, private, line breaks.
_KINDS = ("Cc", "Cf", "Cn", "Cs", "Co", "Zl", "Zp")


def harmless(text: str, keep: str = "") -> str:
    r"""Return a text with everything that is no visible letter written out, as in ``\x1b``.

    Args:
      text: any text.
      keep: letters that may stay, such as a line break.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        letter
        if letter in keep or unicodedata.category(letter) not in _KINDS
        else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )


def one_line(text: str) -> str:
    """Return a text as one harmless line: white space in a row is one space."""
    return harmless(" ".join(text.split()))


def first_line(error: BaseException, most: int = 200) -> str:
    """Return what an error says as one short harmless line; its type where it says nothing."""
    text = one_line(str(error)) or type(error).__name__
    return text if len(text) <= most else text[:most] + "…"
