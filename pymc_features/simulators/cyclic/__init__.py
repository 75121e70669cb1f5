"""A hysteretic specimen under a prescribed displacement: from its parameters to the force."""
