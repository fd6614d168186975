"""What naming and adding an effect has brought, on designs and objects that were never looked at."""
