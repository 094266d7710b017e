"""What a recording says of the sensors."""
