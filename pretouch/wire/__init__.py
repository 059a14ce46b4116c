"""Between the domain types and the wire: protobuf messages, and the JSON of the REST contract."""
