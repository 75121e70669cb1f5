"""A configuration with everything it refers to: channels, structure and priors, and the PyMC model of it."""
