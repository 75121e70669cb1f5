"""Calls of public functions, one or more for each kind of check, with what each argument takes."""
