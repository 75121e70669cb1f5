"""Likelihood of the Fourier transforms of output-only measurements, and its gradient, as compiled kernels.

The transform F_k of s channels at a frequency f_k is complex Gaussian with the covariance

    E_k = Phi H_k S H_k^* Phi' + diag(S_e),  S = L L^*,  H_k = diag(h_r),
    h_r = (2 pi i f_k)^(-q) / (1 - (f_r / f_k)^2 - 2 i zeta_r f_r / f_k)

with the spectral density S of the modal forces and S_e of the prediction error, both one-sided, and q = 0, 1,
2 for accelerations, velocities and displacements (S.-K. Au, Operational Modal Analysis, Springer 2017, ch. 10
and 12). Everything is reduced to matrices of the rank r of L: with B = H L, G = Phi diag(S_e)^-1 Phi' and
u = Phi diag(S_e)^-1 F, by the lemmas of Woodbury and Sylvester,

    K = I + B^* G B,  ln|E| = ln|S_e| + ln|K|,  F^* E^-1 F = F^* S_e^-1 F - v^* K^-1 v,  v = B^* u.

Frequencies lie in the lanes of vectors.
"""

from pymc_features.simulators.spectra.arguments import MULTIPLE, Lines, SpectralParameters
from pymc_features.simulators.spectra.density import spectral_logp
from pymc_features.simulators.spectra.gradient import spectral_gradient

__all__ = ["MULTIPLE", "Lines", "SpectralParameters", "spectral_gradient", "spectral_logp"]
