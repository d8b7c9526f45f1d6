/* Sizes and data of heat for pages: variables, which a page sets before it uses the kernel. */
typedef int model_function; /* number of a formula of the page, from 1; 0 for none */
#define MODEL_AT(function, point) mechanics_formula(function, point)
typedef struct {
    int parameters, outputs, bodies, sliding, coordinates, supplies, conducting, sliding_contacts;
} model_sizes;
typedef struct {
    const double *lower, *upper, *areas, *compliances, *per_heat, *compliance, *levels, *jumps, *supplied;
    const double *slack_by_friction, *jump_by_friction, *supplied_by_friction, *places;
    const int *flow_output, *friction_output, *sliding, *supply, *conductance, *friction;
} model_data;
static model_sizes model_counts;
static model_data model_all;

#define MODEL_MODES 0 /* a page has steady heat */
#define MODEL_PARAMETERS model_counts.parameters
#define MODEL_GIVEN model_counts.parameters
#define MODEL_OUTPUTS model_counts.outputs
#define MODEL_BODIES model_counts.bodies
#define MODEL_SLIDING model_counts.sliding
#define MODEL_COORDINATES model_counts.coordinates
#define MODEL_SUPPLIES model_counts.supplies
#define MODEL_CONDUCTING model_counts.conducting
#define MODEL_RUBBING model_counts.sliding_contacts

#define model_lower model_all.lower
#define model_upper model_all.upper
#define model_areas model_all.areas
#define model_compliances model_all.compliances
#define model_per_heat model_all.per_heat
#define model_compliance model_all.compliance
#define model_levels model_all.levels
#define model_jumps model_all.jumps
#define model_supplied model_all.supplied
#define model_slack_by_friction model_all.slack_by_friction
#define model_jump_by_friction model_all.jump_by_friction
#define model_supplied_by_friction model_all.supplied_by_friction
#define model_places model_all.places
#define model_flow_output model_all.flow_output
#define model_friction_output model_all.friction_output
#define model_sliding model_all.sliding
#define model_supply model_all.supply
#define model_conductance model_all.conductance
#define model_friction model_all.friction
