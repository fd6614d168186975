"""Laumas weight transmitter over Modbus: register codec and driver."""
