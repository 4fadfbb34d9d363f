"""The zoo: textbook systems, measured badly on purpose, and how well they are found again."""
