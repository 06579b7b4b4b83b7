from hypothesis import settings

# The same examples each time: what passed once passes again, until somebody changes the code.
settings.register_profile("repeatable", derandomize=True)
settings.load_profile("repeatable")
