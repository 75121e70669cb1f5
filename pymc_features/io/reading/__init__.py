"""What all readers share: lines and numbers, units and steps, clocks, and what a format is."""
