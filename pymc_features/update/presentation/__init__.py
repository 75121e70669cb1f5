"""What an update shows of data and results: numbers, tables, figures, mode shapes."""
