"""Quasi-static, large-rotation finite elements with frictional contact: closing and pull-off of a finger."""
