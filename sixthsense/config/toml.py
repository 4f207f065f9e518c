"""Parsing of untrusted TOML in bounded time."""

from __future__ import annotations

import re
import tomllib
from typing import Any

# The parser's time grows with the square of a dotted key's length: 24 kB of `a.a.a...` take eight seconds.
_DEEP_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]+[ \t]*\.[ \t]*){20}""")


def parse_toml(text: str) -> dict[str, Any]:
    """The table of a TOML text; ValueError says in a few words why it is invalid."""
    if _DEEP_KEY.search(text):
        raise ValueError("is not usable TOML (found a key of over 20 parts)")
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ValueError(f"is not TOML ({error})") from None
    except ValueError as error:  # Python's limit on the digits of an integer
        raise ValueError(f"is not usable TOML ({str(error).split(';')[0]})") from None
