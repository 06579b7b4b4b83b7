from hypothesis import settings

# The same examples each time, however busy the machine: what passed once passes again, until
# somebody changes the code.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")
