"""What all readers share: lines, labels, units, clocks, and the channels of a recording."""
