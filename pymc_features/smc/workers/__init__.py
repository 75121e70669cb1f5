"""Populations, and chains, on several processes or a cluster."""
