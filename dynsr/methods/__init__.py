"""Methods that search for the equation of one state: the GA, SINDy and DynAIFeynman."""
