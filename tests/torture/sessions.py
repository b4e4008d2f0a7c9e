"""One simulated session, from motion through bytes, decoder, stillness and guide to the fit, and how far off it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import load_protocol
from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.models import to_vector
from imufield.campaign import run_campaign
from imufield.earth import Gravity, choose_gravity
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme
from imufield.samples import FloatArray
from imufield.simulate.emulator.emulate import Emulation, choose_wire, make_device, make_virtual_imu
from imufield.simulate.instruments.stim300 import Stim300Device
from imufield.simulate.truth.operator import OperatorSettings
from tests.torture.conftest import FULL

RATE_HZ = 125.0
BLOCK = 2500
HOLD_S = 5.0
VISIT_S = 14.5
"""The operator stays long enough in a position for a hold that is refused to be repeated."""
PARAMETERS = (
    *("scale x", "scale y", "scale z", "bias x", "bias y", "bias z"),
    *("angle yz", "angle zx", "angle xy", "quadratic x", "quadratic y", "quadratic z"),
)
"""The gauge-free parameters of the quadratic model, in the order of ``error_in_sigma``."""


@dataclass(frozen=True)
class Sessions:
    """What all sessions of one grade have in common; the seed makes the difference."""

    grade: str
    model: str = "quadratic"

    def error_over_limit(self, seed: int) -> FloatArray:
        """Return the gauge-free errors of one session in units of their stated 95 % limit, shape (12,)."""
        positions = scheme("paper24")
        habits = OperatorSettings(hold_s=VISIT_S, initial_still_s=6.0, begins_in_first_position=True)
        options = Emulation(
            device="stim300", rate_hz=RATE_HZ, grade=self.grade, seed=seed, directions=positions.directions(), operator=habits
        )
        source = make_virtual_imu(options)
        wire = choose_wire(options)
        device = make_device(options, wire)
        assert isinstance(device, Stim300Device)
        protocol = load_protocol("stim300", {"accelerometer_range_g": device.format.accelerometer_range_g})
        decoder = Decoder(protocol)
        guide = Guide(positions, protocol.units, settings=GuideSettings(hold_s=HOLD_S))
        end_s = source.operator.plan_all() + 2.0
        while not guide.done and source.time_s < end_s:
            guide.feed(decoder.feed(device.encode(source.next_block(BLOCK)).data.tobytes()))
        observations = guide.observations()
        assert len(observations) == len(positions), f"{self.grade} {seed}: {len(observations)} positions"
        gravity = self._typed_gravity(options.site.gravity_m_s2, seed)
        calibration = calibrate_accelerometer(observations, gravity, model=self.model)  # type: ignore[arg-type]
        found = calibration.intrinsic
        truth = source.imu.instrument.accelerometer
        truth = replace(truth, bias_m_s2=truth.bias_m_s2 + source.imu.mean_drift[:3])
        true, _ = intrinsic(to_vector(truth))
        values = np.concatenate([found.scale, found.bias_raw, found.angle_rad, found.quadratic])
        sigma = np.concatenate([found.scale_sigma, found.bias_raw_sigma, found.angle_sigma_rad, found.quadratic_sigma])
        error: FloatArray = (values - true) / (calibration.quality.student_factor_95 * sigma)
        return error

    @staticmethod
    def _typed_gravity(true_m_s2: float, seed: int) -> Gravity:
        """Return what a person types, as far off as is believed of it: else the scale would seem to be known too badly."""
        exact = choose_gravity(true_m_s2)
        error_m_s2 = exact.sigma_m_s2 * np.random.default_rng([seed, 981]).standard_normal()
        return replace(exact, gravity_m_s2=true_m_s2 + float(error_m_s2))

    def errors_over_limit(self, seeds: int) -> FloatArray:
        """Return the errors of sessions 0 to ``seeds`` in units of their limit, shape (seeds, 12)."""
        # The few of the short form are done before other processes have imported what they need.
        return np.array(run_campaign(self._run, range(seeds), seed=0, workers=None if FULL else 1))

    def _run(self, seed: int, _rng: np.random.Generator) -> FloatArray:
        return self.error_over_limit(seed)
