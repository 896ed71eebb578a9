"""DCE, deep coded exposure: one code for all motions, learned together with the network that
restores its photos.

Zhang et al., "Deep coded exposure: end-to-end co-optimization of flutter shutter and deblurring
processing for general motion blur removal", Photonics Research 11(10), 1678, 2023.

As there: photos are the mean over all frames, closed ones dark, plus Gaussian noise to 0.02; start
code, losses and straight-through estimator; the code is held first. Otherwise here: motions shift
a photo as a whole instead of being filmed; a frame is smeared over its chip; the network is a
small U-Net instead of DeepRFT; its input is the photo over the code's duty; its target is the
scene at the path's time-mean instead of the middle frame; and in the network's last quarter of
training the code no longer changes.
"""
