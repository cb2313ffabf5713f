"""Numbers as people write them."""

from __future__ import annotations

import math

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float, digits: int = 4) -> str:
    """Return a number as text, with powers of ten only far from 1; also infinity and NaN."""
    if math.isfinite(value) and value != 0 and not 1e-3 <= abs(value) < 1e5:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return f"{float(mantissa):g}·10".replace("-", "−") + str(int(exponent)).translate(_SUPERSCRIPT)
    text = f"{value:.{digits}g}"
    return (f"{float(text):.0f}" if "e" in text else text).replace("-", "−")


def percent(share: float, sign: bool = False) -> str:
    """Return a share of 1 in percent; `sign`: with the sign of a change."""
    rounded = round(100 * share, 0) + 0.0
    return f"{rounded:{'+' if sign and rounded else ''}.0f} %".replace("-", "−")


def with_std(value: float, std: float, unit: str) -> str:
    """Return `0.2821 ± 0.0002 N·m`, with the digits that the standard deviation allows; without it if it is not positive."""
    tail = f" {unit}" if unit and unit != "1" else ""
    if not 0 < std < math.inf:
        return f"{number(value)}{tail}"
    largest = max(abs(value), std)
    power = 0 if 1e-3 <= largest < 1e5 and std >= 1e-5 else math.floor(math.log10(largest))
    value, std = value / 10.0**power, std / 10.0**power
    decimals = -math.floor(math.log10(std))
    if round(std * 10**decimals) == 1:  # a second digit where the first is 1
        decimals += 1
    decimals = min(max(decimals, 0), 6)
    both = f"{value:.{decimals}f} ± {std:.{decimals}f}".replace("-", "−")
    return f"({both})·10{str(power).translate(_SUPERSCRIPT)}{tail}" if power else f"{both}{tail}"
