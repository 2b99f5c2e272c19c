"""A second-order Butterworth low-pass, run forwards and backwards: no lag, twice the slope."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
HIGHEST = 0.4  # of the frame rate: nothing is left to take away above such a cutoff
_PAD = 9  # frames by which a signal is continued at either end, mirrored about its last value
_GONE = 1e-18  # an impulse response that stays below this has ended


def low_pass(signal: Array, cutoff: float, fps: float) -> Array:
    """Return a signal without what is faster than a cutoff, as ``scipy.signal.filtfilt`` does.

    Args:
      signal: (nframe, …) values.
      cutoff: where the amplitude is half (both ways together) [Hz].
      fps: frames a second. Where the cutoff is 0.4 of it or more the signal stays as it is.
    """
    if cutoff >= HIGHEST * fps or len(signal) < 3:
        return signal
    pad = min(_PAD, len(signal) - 1)
    before = 2.0 * signal[0] - signal[pad:0:-1]
    after = 2.0 * signal[-1] - signal[-2 : -pad - 2 : -1]
    whole = np.concatenate((before, signal, after))
    response = _impulse_response(cutoff / fps, len(whole))
    once = _convolve(whole, response)
    return _convolve(once[::-1], response)[::-1][pad : len(whole) - pad]


def _impulse_response(cutoff: float, count: int) -> Array:
    """Return the first values of the filter's answer to a 1; ``cutoff`` in cycles a frame."""
    warped = math.tan(math.pi * cutoff)
    scale = 1.0 / (1.0 + math.sqrt(2.0) * warped + warped**2)
    gain = warped**2 * scale
    first = 2.0 * (warped**2 - 1.0) * scale
    second = (1.0 - math.sqrt(2.0) * warped + warped**2) * scale
    response, last, before = [], 0.0, 0.0
    for i, put_in in zip(range(count), [1.0, 2.0, 1.0] + [0.0] * count, strict=False):
        # Each value is made of the two before it: plain numbers, and few until it has ended.
        last, before = gain * put_in - first * last - second * before, last
        response.append(last)
        if i > 2 and abs(last) + abs(before) < _GONE:
            break
    return np.array(response)


def _convolve(signal: Array, response: Array) -> Array:
    """Return a filtered signal (n, …) that has been at its first value for ever."""
    start, count = signal[:1], len(signal)
    size = 1 << (count + len(response) - 2).bit_length()
    spectrum = np.fft.rfft(response, size).reshape(-1, *(1,) * (signal.ndim - 1))
    answer = np.fft.irfft(np.fft.rfft(signal - start, size, axis=0) * spectrum, size, axis=0)
    return np.asarray(start + answer[:count])
