"""The code of our training of deep coded exposure."""

from cep.optics.code import ShutterCode

DCE_CODE = ShutterCode("11000001010011111111010010001100")
"""One code for all motions, learned with a restoration network after Zhang et al., DCE, Photonics
Research 2023.

The paper publishes no code: this one comes from our training and is no published one.
"""
