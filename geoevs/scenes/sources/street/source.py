class Source:
    has_truth = True
    def __init__(self, height, width, frames=8):
        pass
