"""Tables and figures out."""
