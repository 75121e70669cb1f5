"""Figures of modes and of the spectra they are found in."""
