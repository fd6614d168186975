"""Elasticity: elements, shape functions, assembly."""
