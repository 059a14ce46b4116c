"""What the words beside a number on a line say that it is."""

from __future__ import annotations

import re
from collections.abc import Iterable

_RANGE = re.compile(
    r"mm|cm|m|(?:milli|centi)?met(?:er|re)s?|d|r|(?:dist|rang|tof|lidar|laser|tfmini|tfluna|tf|vl\d|vl)\w*|sensor|zone|prox"
    r"|proximity|reading|measure\w*|value|obstacle|object|finger|tip|left|right|front|back|rear|cent(?:er|re)|middle|top|bottom"
    r"|abstand|entfernung|afstand|avstand|mesafe"
)
_OTHER_LENGTH = re.compile(
    r"[xyz]|avg?|ref|base|set|raw|thr|lim|pos|sum|(?:sig|std|dev|noise|offs|min|max|mean|median|aver|filt|smooth|thres|limit"
    r"|err|corr|prev|last|diff|delta|speed|veloc|temp|roll|pitch|yaw|height|width|size|zero|calib|goal|expect|total|travel"
    r"|posit|wheel|diam|accur|resol)\w*"
)
_TIME = re.compile(
    r"t|time\w*|ts|ms|us|s|sec|seconds?|milli(?:s|seconds?)?|micro(?:s|seconds?)?|elapsed|uptime|ticks?|now"
)
_STATUS = re.compile(r"\w*status|valid|err|error|state|stat|ok|flags?|code|rc|rs|ret|res|result")
_MODULE = re.compile(r"zone|sensor|module|channel|ch|idx|index|id|port|no|nr|tof|target|addr|address")


def says_range(words: Iterable[str]) -> bool:
    """Whether a label says that the number is a range."""
    return _any(_RANGE, words)


def says_other_length(words: Iterable[str]) -> bool:
    """Whether a label says that the number is another length than what a sensor measures at that moment."""
    return _any(_OTHER_LENGTH, words)


def says_time(words: Iterable[str]) -> bool:
    """Whether a label says that the number is a time."""
    return _any(_TIME, words)


def says_status(words: Iterable[str]) -> bool:
    """Whether a label says that the number tells whether the measurement is good."""
    return _any(_STATUS, words)


def says_module(words: Iterable[str]) -> bool:
    """Whether a label says that the number is a sensor's own."""
    return _any(_MODULE, words)


def _any(expression: re.Pattern[str], words: Iterable[str]) -> bool:
    return any(expression.fullmatch(word) for word in words)
