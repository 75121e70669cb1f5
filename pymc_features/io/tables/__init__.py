"""Tables of any layout: columns of numbers in text files, variables of MATLAB files."""
