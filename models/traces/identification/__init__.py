"""Which object a force trace was measured on, and what kind of grasp it shows: docs/explanation/identification.md."""
