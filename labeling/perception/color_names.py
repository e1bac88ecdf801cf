"""What a person would call the colour of some points: `green`, `brown`."""

from __future__ import annotations

import numpy as np

GREY_BELOW = 0.22
"""Saturation under which a colour is white, grey or black."""
BLACK_BELOW, WHITE_ABOVE = 0.22, 0.62
"""Brightness of what is black, and of what is white."""
DARK = 0.5
"""Brightness under which orange is brown."""
HUES = (
    (0.035, "red"), (0.11, "orange"), (0.19, "yellow"), (0.45, "green"), (0.70, "blue"),
    (0.84, "purple"), (0.955, "pink"), (1.0, "red"),
)  # fmt: skip
"""Upper end of each hue, in turns from red."""


def color_name(rgb: np.ndarray) -> str:
    """The colour word that most of the pixels (N, 3) uint8, N >= 1, would get each on its own.

    White and grey count a quarter, for paper shows on every book and light on every mug.
    """
    words, index = np.unique(_words(rgb), return_inverse=True)
    weight = np.where(np.isin(words, ("white", "grey")), 0.25, 1.0)
    return str(words[np.argmax(np.bincount(index.reshape(-1)) * weight)])


def _words(rgb: np.ndarray) -> np.ndarray:
    """A colour word (N,) str for each pixel."""
    values = rgb.reshape(-1, 3).astype(np.float64) / 255
    high, low = values.max(axis=1), values.min(axis=1)
    spread = np.maximum(high - low, 1e-9)
    red, green, blue = values.T
    sixth = np.where(
        high == red,
        ((green - blue) / spread) % 6,
        np.where(high == green, (blue - red) / spread + 2, (red - green) / spread + 4),
    )
    ends = np.array([end for end, _ in HUES])
    words = np.array([word for _, word in HUES])[np.searchsorted(ends, sixth / 6 % 1.0)]
    brown = np.isin(words, ("orange", "red")) & (high < DARK) & (sixth / 6 > 0.02)
    words = np.where(brown & (words == "orange"), "brown", words)
    grey = (high - low) < GREY_BELOW * np.maximum(high, 1e-9)
    shade = np.where(high < BLACK_BELOW, "black", np.where(high > WHITE_ABOVE, "white", "grey"))
    return np.where(grey | (high < BLACK_BELOW / 2), shade, words)
