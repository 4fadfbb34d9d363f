"""What the paper prints: settings, bases, expressions and losses, as data."""
