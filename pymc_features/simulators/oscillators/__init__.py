"""Oscillators q" + D q' + omega^2 q = -a under excitations that are linear between their samples."""
