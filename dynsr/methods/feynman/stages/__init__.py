"""The stages of DynAIFeynman, one a file."""
