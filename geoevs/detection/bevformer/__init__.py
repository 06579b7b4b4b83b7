"""A compact BEVFormer (Li et al., ECCV 2022): boxes from any number of cameras, on any device.

In a notebook, from frames (`inputs.RigFrame`) to boxes:

    detector, fitting = Detector(), Fitting()
    train_backbone(frames, detector, fitting, seed, work / "backbone", folder / "b.safetensors")
    train(frames, folder / "b.safetensors", detector, fitting, seed, work, folder / "d.safetensors")
    detect(folder / "d.safetensors", others)
"""
