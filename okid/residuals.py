"""After the fit: is what the observer leaves over white, and free of the input?"""

from dataclasses import dataclass

from okid.arrays import FloatArray

__all__ = ["ResidualCheck"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ResidualCheck:
    """Hosking's portmanteau test of the residuals and their correlation with past inputs.

    Attributes:
        autocorrelation: (n_lags + 1, n_outputs) of each output's residual, lag 0 is 1.
        whiteness_ratio: statistic over its degrees of freedom; 1 is white, above about 2 is not.
        whiteness_p_value: of the chi-square test; weak evidence by itself when the ratio is near 1.
        input_correlation_ratio: the same for the cross-correlation with the inputs; nan without inputs.
        confidence_limit: 95 % limit of one autocorrelation.
        messages: the findings in words.
    """

    autocorrelation: FloatArray
    whiteness_ratio: float
    whiteness_p_value: float
    input_correlation_ratio: float
    confidence_limit: float
    messages: tuple[str, ...]
