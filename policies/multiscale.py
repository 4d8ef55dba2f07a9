"""Offsets at several scales: what a network sees of a distance, from far to touching."""

from torch import Tensor


def at_scales(offset: Tensor, far: float, *near: float) -> list[Tensor]:
    """An offset in units of the largest scale, and squashed at the smaller ones.

    In double precision: single is MKL's, which rounds by the processor's approximate reciprocals (`_sinusoids` and the
    sampler's square roots likewise).
    """
    return [offset / far, *((offset / scale).double().tanh().to(offset) for scale in near)]
