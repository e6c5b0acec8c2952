"""The sRGB transfer curve (IEC 61966-2-1) between display values and linear light, both in [0, 1]; and greys."""

import numpy as np
from jaxtyping import Float, Float32, UInt8

LINEAR_END = 0.0031308  # linear light below which the curve is a line
STILL_SHARE = 0.5  # grey of still parts over their luminance; at 1, white sand would outshine the plant
LUMINANCE = (0.2126, 0.7152, 0.0722)  # weights of red, green and blue, BT.709


def linear_to_srgb(linear: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Encode linear light as display values; the data type does not change."""
    bounded = np.clip(linear, 0, 1)
    curved = 1.055 * np.maximum(bounded, LINEAR_END) ** (1 / 2.4) - 0.055
    display: Float[np.ndarray, "*shape"] = np.where(bounded <= LINEAR_END, 12.92 * bounded, curved).astype(linear.dtype)
    return display


def srgb_to_linear(display: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Decode display values to linear light; inverse of `linear_to_srgb`."""
    display_end = 0.04045  # `LINEAR_END` as a display value
    curved = ((display + 0.055) / 1.055) ** 2.4
    return np.where(display <= display_end, display / 12.92, curved).astype(display.dtype)


def linear_from_bytes(srgb: UInt8[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
    """Decode sRGB bytes to linear light in [0, 1]."""
    linear: Float32[np.ndarray, "*shape"] = srgb_to_linear(np.arange(256) / 255).astype(np.float32)[srgb]
    return linear


def greyed(rgb: Float32[np.ndarray, "*shape 3"]) -> Float32[np.ndarray, "*shape 3"]:
    """Replace colours by their luminance in all channels, which sets still parts apart from the plant.

    A product of grey factors is grey. The mapping is linear, so it also applies to coefficients of spherical harmonics.
    """
    grey: Float32[np.ndarray, "*shape 1"] = (rgb @ np.array(LUMINANCE, np.float32))[..., None]
    return np.broadcast_to(grey, rgb.shape).copy()


def srgb_slope(linear: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Derivative of `linear_to_srgb`."""
    curved = 1.055 / 2.4 * np.maximum(linear, LINEAR_END) ** (1 / 2.4 - 1)
    return np.where(linear <= LINEAR_END, 12.92, curved).astype(linear.dtype)
