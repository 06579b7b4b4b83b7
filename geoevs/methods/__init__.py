"""The contracts of methods and of their trainings, how they are found and checked."""
