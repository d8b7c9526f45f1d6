/* Calls of heat.h for pages, after those of pages/c/page.c. */
static model_work *model_room;
static double *model_told;

EXPORT(heat_sizes) model_sizes *model_sizes_of(void) { return &model_counts; }
EXPORT(heat_data) model_data *model_data_of(void) { return &model_all; }
EXPORT(heat_ready) int model_ready(void) {
    model_room = model_new(), model_told = malloc((MODEL_OUTPUTS + 1) * sizeof(double));
    return model_room && model_told;
}

/* The answer at a point, from contact without heat or from the answer before; 0 without one. */
EXPORT(heat_solve) int model_solved(const double *point, int anew) {
    if (anew) model_forget(model_room);
    return model_solve(model_room, point, NULL, model_told) == MODEL_DONE;
}
EXPORT(heat_outputs) double *model_outputs_told(void) { return model_told; }

/* Forces, heat flows and temperatures; and the point of the kernel with heat flows, heat of friction and temperatures. */
EXPORT(heat_kept) double *model_kept(void) { return model_room->kept; }
EXPORT(heat_whole) double *model_whole(void) { return model_room->whole; }

/* Amplitudes of supplies and fixed temperatures at the last point. */
EXPORT(heat_supplies) double *model_supplies(void) { return model_room->amplitudes; }
