"""Bytes to and from devices: serial lines, Modbus, logs of them and their replay."""
