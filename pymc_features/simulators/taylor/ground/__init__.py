"""The ground acceleration as polynomials over spans of a record, for chains that take Taylor steps."""
