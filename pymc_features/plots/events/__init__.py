"""Figures of several events."""
