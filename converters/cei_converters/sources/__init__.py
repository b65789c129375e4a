"""What can be converted: formats that demonstrations come in, and what their columns mean."""
