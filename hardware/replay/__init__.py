"""Replay of recorded wires against the drivers."""
