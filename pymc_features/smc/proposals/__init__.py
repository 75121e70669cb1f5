"""Proposals of Metropolis-Hastings steps, fitted to particles."""
