"""What the priors expect beside what was measured, before anything is sampled."""
