"""The brute-force search: distinct functions formed bottom-up, screened in closed form."""
