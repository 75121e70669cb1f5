"""Calls of everything public, with what each argument takes."""
