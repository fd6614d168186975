"""Data in which an effect is hidden: a truth that shares no law with the catalogue, and a lab that measures it."""
