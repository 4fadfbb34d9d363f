"""The stages of DynAIFeynman, one per file."""
