"""CLICK PLC over Modbus TCP: address codec, tags, driver."""
