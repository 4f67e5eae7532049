"""How much time the fits of dynamics may take."""

from pydantic import Field

from valvemap.config.sections import Section


class DynamicsConfig(Section):
    """The dynamics of spool and flow meter, of valves sampled at 100 Hz or more."""

    share: float = Field(
        0.1, ge=0.0, le=1.0, description="largest share of one core; 0: no dynamics are fitted"
    )
    window_s: float = Field(
        60.0, ge=15.0, le=600.0, description="length of the newest samples of a fit"
    )
