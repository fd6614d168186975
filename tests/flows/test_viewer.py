import subprocess
import sys

import numpy as np
import pytest
from rerun.experimental import Recording

