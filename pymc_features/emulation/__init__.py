"""Emulators of external simulators: the posterior from a hundred runs."""

from pymc_features.emulation.emulate import Emulation, emulate

__all__ = ["Emulation", "emulate"]
