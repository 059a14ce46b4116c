"""Recording a device into MCAP files, and playing such a file as if it were the device."""
