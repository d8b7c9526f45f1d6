/* Sizes and data of a kernel for pages: variables, which a page sets before it uses the kernel. */
typedef struct {
    int parameters, conditions, outputs, terms, affine, others, limits, parts, groups, constant, longest, nodes, motions;
    int contacts, tangents, twice, fixed_count;
    int modes, points, components, bodies, shares, moduli, rated, memory, unknowns, registers, constants;
    int ranges, formulas, remembered;
    double softness;
} model_sizes;
typedef struct {
    const double *lower, *upper, *constant, *slopes, *schur, *gaps, *box_lower, *box_upper;
    const int *pairs, *fixed;
    const model_amplitude *others;
    const model_limit *limits;
    const model_part *parts;
    const model_output *outputs;
    model_interpolant reshaped;
    const int *normal, *tangential, *owner, *law_of, *twice, *along;
    const double *area;
    const model_law *laws;
    const double *taken, *driving, *units, *pushes;
    const double *per_mode, *per_force, *forced, *given, *moved, *modal, *coupled, *pressed, *weights, *flow_schur, *middle;
    const int *share_of, *mode_share;
    const model_body *bodies;
    const model_modulus *moduli;
    const model_range *ranges;
} model_data;
static model_sizes model_counts;
static model_data model_all;

#define MODEL_PARAMETERS model_counts.parameters
#define MODEL_CONDITIONS model_counts.conditions
#define MODEL_OUTPUTS model_counts.outputs
#define MODEL_TERMS model_counts.terms
#define MODEL_AFFINE model_counts.affine
#define MODEL_OTHERS model_counts.others
#define MODEL_LIMITS model_counts.limits
#define MODEL_PARTS model_counts.parts
#define MODEL_GROUPS model_counts.groups
#define MODEL_CONSTANT model_counts.constant
#define MODEL_LONGEST model_counts.longest
#define MODEL_NODES model_counts.nodes
#if MODEL_FLOATS
#define MODEL_MOTIONS model_counts.motions
#else
#define MODEL_MOTIONS 0
#endif
#define MODEL_CONTACTS model_counts.contacts
#define MODEL_TANGENTS model_counts.tangents
#define MODEL_TWICE model_counts.twice
#define MODEL_FIXED_COUNT model_counts.fixed_count
#define MODEL_MODES model_counts.modes
#define MODEL_POINTS model_counts.points
#define MODEL_COMPONENTS model_counts.components
#define MODEL_BODIES model_counts.bodies
#define MODEL_SHARES model_counts.shares
#define MODEL_MODULI model_counts.moduli
#define MODEL_RATED model_counts.rated
#define MODEL_MEMORY model_counts.memory
#define MODEL_UNKNOWNS model_counts.unknowns
#define MODEL_REGISTERS model_counts.registers
#define MODEL_CONSTANTS model_counts.constants
#define MODEL_RANGES model_counts.ranges
#define MODEL_FORMULAS model_counts.formulas
#define MODEL_REMEMBERED model_counts.remembered
#define MODEL_SOFTNESS model_counts.softness

#define model_lower model_all.lower
#define model_upper model_all.upper
#define model_constant model_all.constant
#define model_slopes model_all.slopes
#define model_schur model_all.schur
#define model_gaps model_all.gaps
#define model_box_lower model_all.box_lower
#define model_box_upper model_all.box_upper
#define model_pairs model_all.pairs
#define model_fixed model_all.fixed
#define model_others model_all.others
#define model_limits model_all.limits
#define model_parts model_all.parts
#define model_outputs model_all.outputs
#define model_reshaped model_all.reshaped
#define model_normal model_all.normal
#define model_tangential model_all.tangential
#define model_owner model_all.owner
#define model_law_of model_all.law_of
#define model_twice model_all.twice
#define model_along model_all.along
#define model_area model_all.area
#define model_laws model_all.laws
#define model_taken model_all.taken
#define model_driving model_all.driving
#define model_units model_all.units
#define model_pushes model_all.pushes
#define model_per_mode model_all.per_mode
#define model_per_force model_all.per_force
#define model_forced model_all.forced
#define model_given model_all.given
#define model_moved model_all.moved
#define model_modal model_all.modal
#define model_coupled model_all.coupled
#define model_pressed model_all.pressed
#define model_weights model_all.weights
#define model_flow_schur model_all.flow_schur
#define model_middle model_all.middle
#define model_share_of model_all.share_of
#define model_mode_share model_all.mode_share
#define model_bodies model_all.bodies
#define model_moduli model_all.moduli
#define model_ranges model_all.ranges
