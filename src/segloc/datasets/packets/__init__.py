"""Packets as sensors send them, in captures; :mod:`..ros` finds them in bags."""
