"""Rerun recordings of grasps and campaigns, made on demand from the lake."""
