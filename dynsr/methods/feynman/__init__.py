"""DynAIFeynman: AI Feynman 2.0 extended to the slopes of trajectories."""
