"""The commands of ``dynsr``, one file a theme; each loads what it runs on first use."""
