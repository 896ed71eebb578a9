"""Frames restored together: as good as less noise, and as along the worse direction."""

from dataclasses import replace

import numpy as np
import pytest

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.search.expected import ExpectedPsnr, light_noise
from cep.search.problem import SearchProblem
from lab.frames.expected import joint_psnr_db
from motdiff.motions import boracchi_foi
from motdiff.trajectory import Trajectory

CAMERA = Camera(photons_full_scale=2_000, read_noise_e=20)


def test_frames_through_one_code_divide_its_noise_and_through_others_fill_its_zeros():
    straight = SearchProblem.along(Trajectory.straight(12.0), chips=12, camera=CAMERA)
    codes = [ShutterCode("111100000000"), ShutterCode("110100011101")]
    noise = np.array([light_noise(CAMERA, codes)])
    single = ExpectedPsnr(straight).psnr_db(codes, noise=noise)[:, 0]
    twice = ExpectedPsnr(straight).psnr_db(codes, noise=noise / 2)[:, 0]
    same = [
        joint_psnr_db(straight, [code] * 2, noise=noise[:, [i, i]])[0]
        for i, code in enumerate(codes)
    ]
    assert same == pytest.approx(twice)
    assert joint_psnr_db(straight, codes, noise=noise)[0] > single.max()


def test_frames_along_an_unknown_direction_are_as_good_as_along_the_worse_one():
    path = boracchi_foi(np.random.default_rng(4), max_length_px=20, samples=60)
    codes = [ShutterCode("110100000"), ShutterCode("000010111")]
    noise = np.array([light_noise(CAMERA, codes), light_noise(CAMERA, codes) * 4])
    ways = [replace(one, direction="known") for one in (path, path.reversed())]
    both, *each = (
        joint_psnr_db(SearchProblem.along(one, chips=9, camera=CAMERA), codes, noise=noise)
        for one in (replace(path, direction="unknown"), *ways)
    )
    assert both == pytest.approx(np.minimum(*each))
