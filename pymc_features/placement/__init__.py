"""Placement of sensors, before there are any data."""

from pymc_features.placement.sensors import sensor_placement

__all__ = ["sensor_placement"]
