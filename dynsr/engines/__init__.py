"""The engines that integrate and regress: ``embedded`` (default, Python) and ``julia``."""
