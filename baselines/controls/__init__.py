"""Control methods: floors, ceilings and simple baselines that need no training."""
