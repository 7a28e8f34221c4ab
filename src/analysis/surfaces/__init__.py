"""One surface per file: its geometric model, its fit and its clouds."""
