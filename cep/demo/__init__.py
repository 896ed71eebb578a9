"""The whole chain on one photo, to one HTML report: calibrate, optimise, export, expose, restore."""

from cep.demo.chain import Chain, run_chain
from cep.demo.files import DEMO_FILES, write_demo
from cep.demo.page import demo_report
from cep.demo.scene import Scene, bundled_scene, own_photo

__all__ = ["DEMO_FILES", "Chain", "Scene", "bundled_scene", "demo_report", "own_photo", "run_chain", "write_demo"]
