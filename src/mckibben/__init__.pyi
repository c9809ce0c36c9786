from .actuator import (
    FirstOrderValve as FirstOrderValve,
    FlowValve as FlowValve,
    IdealValve as IdealValve,
    PressureRegulator as PressureRegulator,
    SwitchingValves as SwitchingValves,
    Tube as Tube,
    UnequalValves as UnequalValves,
)
from . import catalog as catalog, joint as joint, robot as robot, report as report, units as units
from .control import (
    PID as PID,
    BackpropPID as BackpropPID,
    Constant as Constant,
    DecouplingControl as DecouplingControl,
    DelayCompensation as DelayCompensation,
    ExtendedStateObserver as ExtendedStateObserver,
    InverseModelControl as InverseModelControl,
    Multisine as Multisine,
    OpenLoopControl as OpenLoopControl,
    PolePlacement as PolePlacement,
    PositionStiffnessControl as PositionStiffnessControl,
    PredictiveControl as PredictiveControl,
    Ramp as Ramp,
    RandomSteps as RandomSteps,
    Reference as Reference,
    Samples as Samples,
    Sine as Sine,
    SlidingMode as SlidingMode,
    Step as Step,
    VelocityObserver as VelocityObserver,
)
from .dataset import (
    IsobaricDataset as IsobaricDataset,
    Recipe as Recipe,
    Recording as Recording,
    read_dataset as read_dataset,
    read_recording as read_recording,
)
from .errors import (
    McKibbenError as McKibbenError,
)
from .experiment_design import (
    plan as plan,
)
from .identification import (
    Fit as Fit,
    FitWithFriction as FitWithFriction,
    identify_hysteresis as identify_hysteresis,
    rank as rank,
    read_law as read_law,
    validate as validate,
)
from .joint import (
    AntagonisticJoint as AntagonisticJoint,
    Cam as Cam,
    GeneralLoad as GeneralLoad,
    KneeGeometry as KneeGeometry,
    KneeLoad as KneeLoad,
    Load as Load,
    PairedPaths as PairedPaths,
    Pulley as Pulley,
    PendulumLoad as PendulumLoad,
    RigidTendon as RigidTendon,
    SeriesSpring as SeriesSpring,
    TabulatedPath as TabulatedPath,
    TwoBonePath as TwoBonePath,
)
from .muscle import (
    ChouLaw as ChouLaw,
    Domain as Domain,
    ExponentialLaw as ExponentialLaw,
    MaxwellCreep as MaxwellCreep,
    MaxwellSlip as MaxwellSlip,
    Muscle as Muscle,
    SmoothLaw as SmoothLaw,
    Specimen as Specimen,
    return_spring as return_spring,
)
from .paper import (
    reproduce as reproduce,
)
from .plant import (
    JointFriction as JointFriction,
    JointPlant as JointPlant,
    SampledSensors as SampledSensors,
)
from .reachability import (
    Requirement as Requirement,
    size as size,
)
from .rig import (
    IsobaricProtocol as IsobaricProtocol,
    SimulatedIsobaricTest as SimulatedIsobaricTest,
)
from .simulation import (
    SimulationResult as SimulationResult,
    check_reference as check_reference,
    closed_valves as closed_valves,
    differentiate as differentiate,
    dynamic_stiffness as dynamic_stiffness,
    simulate as simulate,
    simulate_many as simulate_many,
)
from .scenario import (
    Scenario as Scenario,
    read_scenario as read_scenario,
)
from .scenario.inputs import (
    identify as identify,
)
from .study.sweep import (
    sweep as sweep,
)
from .study.tune import (
    tune as tune,
)

__version__: str
