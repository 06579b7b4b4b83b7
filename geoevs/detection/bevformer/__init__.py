"""A compact BEVFormer (Li et al., ECCV 2022): boxes from any number of cameras, on any device.

In a notebook, from frames (`inputs.RigFrame`) to boxes, `pretrained` being a folder of weights:

    detector, fitting = Detector(), Fitting()
    train_backbone(frames, detector, fitting, 0, work / "b", work / "b.safetensors", pretrained)
    train(frames, work / "b.safetensors", detector, fitting, 0, work / "d", work / "d.safetensors")
    detect(work / "d.safetensors", others)

Features that several detectors see can be made once (`features`). What is faithful, and what is
scaled down, says docs/bevformer.md.
"""
