"""What stands in a report of `update`: its words without the scripts, and the data that those draw."""

import base64
import json
import re

import numpy as np


def words(html: str) -> str:
    """The page without scripts and styles, and without the attributes of its cells."""
    html = re.sub(r"<(script|style)[^>]*>.*?</\1>", "", html, flags=re.DOTALL)
    return re.sub(r"<(t[dhr])[^>]*>", r"<\1>", html)


def payload(html: str, name: str = "payload") -> dict:
    """The JSON of a page."""
    [text] = re.findall(rf'<script type="application/json" id="{name}">(.*?)</script>', html, flags=re.DOTALL)
    return json.loads(text)


def unpacked(packed: dict) -> np.ndarray:
    """The numbers of a packed array, by NumPy as the page does it by JavaScript."""
    whole = np.frombuffer(base64.b64decode(packed["b"]), f"<i{packed['bits'] // 8}").astype(float)
    half = 2 ** (packed["bits"] - 1) - 1
    values = packed["low"] + packed["step"] * (whole + half)
    values[whole < -half] = np.nan
    return (10.0**values if packed.get("log") else values).reshape(packed["shape"])
