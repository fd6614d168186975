"""Bytes to and from devices: serial lines, Modbus, and logs of them."""
