"""Prior and likelihood of a PyMC model, for a whole population of particles at once."""
