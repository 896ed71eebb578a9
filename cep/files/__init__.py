"""Files: images, codes and PSFs, outputs that are written whole or not at all."""
