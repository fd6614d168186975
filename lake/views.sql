-- Views and macros for people. The tables are those of lake/tables.py, without superseded rows.
-- Each statement starts with CREATE VIEW or CREATE MACRO; the names are read from here.

-- Position of the first positive number of a list (1 is the first); NULL when there is none.
CREATE MACRO first_positive(a) AS list_position(list_transform(a, lambda x: x > 0), true);

-- Position of the last sample before the lift (1 is the first sample); NULL when nothing was lifted.
CREATE MACRO lift_start(lift_mm) AS first_positive(lift_mm) - (first_positive(lift_mm) > 1)::INTEGER;

-- Sum of the products of two lists of equal length.
CREATE MACRO dot(a, b) AS list_inner_product(a::DOUBLE[], b::DOUBLE[]);

-- Work to break the grasp, in J: trapezoids under force over lift, from the start of the lift (Fig. 2c).
-- The sum of (f[k] + f[k+1]) / 2 * (l[k+1] - l[k]) is half of what two dot products and the ends give; that takes
-- half the time of a lambda over the samples.
CREATE MACRO work_j(lift_mm, force_n) AS
    0.5e-3 * coalesce(
        dot(force_n[lift_start(lift_mm):-2], lift_mm[lift_start(lift_mm) + 1:])
        - dot(force_n[lift_start(lift_mm) + 1:], lift_mm[lift_start(lift_mm):-2])
        + force_n[-1] * lift_mm[-1]
        - force_n[lift_start(lift_mm)] * lift_mm[lift_start(lift_mm)], 0);

-- Peak pull-off force, in N: the largest force during the lift.
-- Where the largest force of all lies in the lift it is the peak, and the start of the lift need not be looked for.
CREATE MACRO peak_force_n(lift_mm, force_n) AS
    CASE WHEN lift_mm[list_position(force_n, list_max(force_n))] > 0 THEN list_max(force_n)
        ELSE coalesce(list_max(force_n[lift_start(lift_mm):]), 0) END;

-- Lift at the peak pull-off force, in mm; NULL when nothing was lifted.
CREATE MACRO peak_lift_mm(lift_mm, force_n) AS
    lift_mm[lift_start(lift_mm) - 1
        + list_position(force_n[lift_start(lift_mm):], list_max(force_n[lift_start(lift_mm):]))];

-- Force at a given lift, in N, between samples linear; NULL where the lift did not reach.
CREATE MACRO force_at_n(lift_mm, force_n, at_mm) AS
    list_transform(
        [list_filter(range(lift_start(lift_mm), len(lift_mm) + 1), lambda k: lift_mm[k] >= at_mm)[1]],
        lambda k: CASE
            WHEN at_mm < 0 THEN NULL
            WHEN k = lift_start(lift_mm) THEN force_n[k]
            ELSE force_n[k - 1]
                + (force_n[k] - force_n[k - 1]) * (at_mm - lift_mm[k - 1]) / (lift_mm[k] - lift_mm[k - 1]) END
    )[1];

-- Lift at separation, in mm: of the last sample that holds a tenth of the peak, and 0.5 N (noise) at least.
-- NULL when the force never reached 0.5 N. The inner list holds the threshold, so that it is computed once.
CREATE MACRO separation_lift_mm(lift_mm, force_n) AS
    list_transform(
        [greatest(peak_force_n(lift_mm, force_n) / 10, 0.5)],
        lambda least_n: lift_mm[list_max(list_filter(
            range(lift_start(lift_mm), len(lift_mm) + 1), lambda k: force_n[k] >= least_n
        ))]
    )[1];

-- Lift over which the force stays above this fraction of its peak, in mm, all stretches together.
CREATE MACRO lift_above_mm(lift_mm, force_n, fraction) AS
    list_transform(
        [peak_force_n(lift_mm, force_n) * fraction],
        lambda least_n: coalesce(list_sum(list_transform(
            range(lift_start(lift_mm), len(lift_mm)),
            lambda k: CASE WHEN force_n[k] + force_n[k + 1] >= 2 * least_n THEN lift_mm[k + 1] - lift_mm[k] ELSE 0 END
        )), 0)
    )[1];

-- Samples of one measured grasp: SELECT * FROM trace('K...').
CREATE MACRO trace(wanted) AS TABLE
    SELECT unnest(time_s) AS time_s, unnest(lift_mm) AS lift_mm, unnest(force_n) AS force_n
    FROM traces WHERE grasp_id = wanted;

-- Samples of one simulated grasp: SELECT * FROM sim_trace('S...').
CREATE MACRO sim_trace(wanted) AS TABLE
    SELECT unnest(time_s) AS time_s, unnest(lift_mm) AS lift_mm, unnest(force_n) AS force_n
    FROM sim_traces WHERE simulation_id = wanted;

-- Joint draws of theta of one calibration: SELECT * FROM posterior('C...').
CREATE MACRO posterior(wanted) AS TABLE
    SELECT
        chain, unnest(range(1, len(e) + 1)) AS draw,
        unnest(e) AS young_modulus_mpa, unnest(f) AS friction, unnest(p) AS poisson_ratio
    FROM (
        SELECT
            chain,
            any_value(draws) FILTER (parameter = 'young_modulus_mpa') AS e,
            any_value(draws) FILTER (parameter = 'friction') AS f,
            any_value(draws) FILTER (parameter = 'poisson_ratio') AS p
        FROM posterior_draws WHERE calibration_id = wanted GROUP BY chain
    );

-- The base setup of each campaign: that of most of its ordinary grasps, which nobody asked for.
CREATE VIEW base_setups AS
    SELECT campaign_id, setup_id FROM grasps WHERE request_id IS NULL GROUP BY campaign_id, setup_id
    QUALIFY row_number() OVER (PARTITION BY campaign_id ORDER BY count(*) DESC, setup_id) = 1;

-- One row per grasp attempt. `is_valid`: it succeeded, and no later attempt of the same grasp did. `is_base`: an ordinary
-- grasp at the base setup of its campaign; others say something of the simulator, and nothing of a tool's quality.
CREATE VIEW grasp_summary AS
    SELECT
        g.grasp_id, g.campaign_id, g.tool_id, g.batch, g.slot, g.design_id, g.object_id,
        o.name AS object_name, o.object_class, g.repeat, g.attempt, g."order", g.status, g.reason,
        g.status = 'ok' AND g.attempt = max(g.attempt) FILTER (WHERE g.status = 'ok')
            OVER (PARTITION BY g.tool_id, g.object_id, g.repeat, g.setup_id, g.request_id) AS is_valid,
        g.started_at, g.peak_force_n, g.work_j, g.initial_force_n, g.tare_force_n, g.setup_id,
        g.request_id IS NULL AND b.setup_id IS NOT NULL AS is_base,
        g.setup_json, coalesce(g.offset_x_mm, 0) AS offset_x_mm, coalesce(g.offset_y_mm, 0) AS offset_y_mm,
        coalesce(g.yaw_deg, 0) AS yaw_deg, g.request_id, g.bench
    FROM grasps AS g LEFT JOIN objects AS o USING (object_id)
    LEFT JOIN base_setups AS b ON b.campaign_id = g.campaign_id AND b.setup_id = g.setup_id;

-- The setups of each campaign: how its grasps were made, and how many.
CREATE VIEW campaign_setups AS
    SELECT
        campaign_id, setup_id, bool_or(is_base) AS is_base,
        any_value((setup_json ->> '$.lift_speed_mm_per_s')::DOUBLE) AS lift_speed_mm_per_s,
        any_value((setup_json ->> '$.close_speed_mm_per_s')::DOUBLE) AS close_speed_mm_per_s,
        any_value(coalesce((setup_json ->> '$.dwell_s')::DOUBLE, 0)) AS dwell_s,
        any_value((setup_json ->> '$.open_gap_mm')::DOUBLE) AS open_gap_mm,
        any_value((setup_json ->> '$.closed_gap_mm')::DOUBLE) AS closed_gap_mm,
        any_value((setup_json ->> '$.tip_below_mm')::DOUBLE) AS tip_below_mm,
        any_value((setup_json ->> '$.supply_pressure_psi')::DOUBLE) AS supply_pressure_psi,
        any_value(offset_x_mm) AS offset_x_mm, any_value(offset_y_mm) AS offset_y_mm, any_value(yaw_deg) AS yaw_deg,
        count(*) AS n_grasps, count(request_id) AS n_asked
    FROM grasp_summary WHERE is_valid GROUP BY campaign_id, setup_id;

-- One row per grasp that a search asks for, in its order, with what became of it.
CREATE VIEW asked_grasps AS
    SELECT
        r.search_id, r.place, r.request_id, r.campaign_id, r.tool_id, r.object_id, r.repeat, r.setup_id, r.purpose,
        CASE WHEN count(g.grasp_id) FILTER (g.status = 'ok') > 0 THEN 'made'
            WHEN count(g.grasp_id) FILTER (coalesce(g.details_json ->> '$.end', '') <> 'bench_fault')
                + count(g.details_json ->> '$.told_by') > 1 THEN 'given up'  -- what a person tells is final
            ELSE 'open' END AS state,
        max(g.grasp_id) FILTER (g.status = 'ok') AS grasp_id,
        count(g.grasp_id) AS n_attempts
    FROM grasp_requests AS r LEFT JOIN grasps AS g USING (request_id) GROUP BY ALL;

-- When the trace of each grasp was written, and its place in the order of the lake. Files are mostly in the order of
-- time too: a join by grasp and time reads only its stretch.
CREATE VIEW trace_times AS
    SELECT grasp_id, created_at, sequence FROM traces;

-- One row per grasp attempt with a trace, with its samples. Of one tool, batch or campaign only those are read.
CREATE VIEW grasp_traces AS
    SELECT g.*, t.time_s, t.lift_mm, t.force_n
    FROM grasp_summary AS g JOIN trace_times AS w USING (grasp_id)
    JOIN traces AS t ON t.grasp_id = w.grasp_id AND t.created_at = w.created_at;

-- One row per valid grasp, with what its samples tell. Only the features asked for are computed.
CREATE VIEW grasp_features AS
    SELECT
        g.* EXCLUDE (status, reason, is_valid, attempt, setup_json, time_s, lift_mm, force_n),
        peak_lift_mm(lift_mm, force_n) AS peak_lift_mm,
        separation_lift_mm(lift_mm, force_n) AS separation_lift_mm,
        lift_above_mm(lift_mm, force_n, 0.5) AS half_peak_lift_mm,
        lift_above_mm(lift_mm, force_n, 0.8) AS plateau_mm
    FROM grasp_traces AS g WHERE is_valid;

-- One row per tool and object: mean over the repeats at the base setup, and how far the repeats lie apart.
CREATE VIEW tool_object AS
    SELECT
        campaign_id, tool_id, batch, slot, design_id, object_id, object_name, object_class, setup_id,
        count(*) AS n_repeats,
        avg(peak_force_n) AS peak_force_n,
        stddev_samp(peak_force_n) AS repeat_sd_n,
        avg(work_j) AS work_j,
        avg(initial_force_n) AS initial_force_n
    FROM grasp_summary WHERE is_valid AND is_base
    GROUP BY ALL;

-- One row per valid grasp that `fast features` has seen: its row of `trace_features`, of the newest definitions.
CREATE VIEW feature_summary AS
    SELECT
        g.campaign_id, g.tool_id, g.batch, g.slot, g.design_id, g.object_id, g.object_name, g.object_class,
        g.repeat, g.setup_id, g.is_base,
        f.* EXCLUDE (feature_id, feature_version, code_version, code_dirty, config_hash, seed, parents, created_at)
    FROM grasp_summary AS g JOIN trace_features AS f USING (grasp_id)
    WHERE g.is_valid AND f.feature_version = (SELECT max(feature_version) FROM trace_features);

-- One row per thing that went wrong with a valid grasp, as `fast features` found when it last looked.
CREATE VIEW anomalies AS
    SELECT
        g.campaign_id, g.tool_id, g.batch, g.slot, g.object_id, g.object_name, g.repeat, a.grasp_id,
        a.kind, a.p_value, a.compared, a.shortfall, a.reason
    FROM anomaly_flags AS a JOIN grasp_summary AS g USING (grasp_id)
    WHERE a.is_flagged AND g.is_valid;

-- One row per tool and object: how well the repeats agree at the base setup. Coefficients of variation are relative standard deviations.
-- `trace_distance_n` is the standard deviation of the repeats' forces at the same lift, root mean square along the
-- profiles. All three are NULL for a single repeat.
CREATE VIEW repeatability AS
    WITH distances AS (
        SELECT tool_id, object_id, setup_id, sqrt(avg(variance)) AS trace_distance_n
        FROM (
            SELECT tool_id, object_id, setup_id, step, var_samp(force_n) AS variance
            FROM (
                SELECT
                    tool_id, object_id, setup_id,
                    unnest(range(1, len(profile_n) + 1)) AS step, unnest(profile_n) AS force_n
                FROM feature_summary WHERE is_base
            )
            GROUP BY ALL
        )
        GROUP BY ALL
    ),
    groups AS (
        SELECT
            campaign_id, tool_id, batch, slot, design_id, object_id, object_name, object_class, setup_id,
            count(*) AS n_repeats, avg(peak_force_n) AS peak_force_n, avg(work_j) AS work_j,
            stddev_samp(peak_force_n) / nullif(abs(avg(peak_force_n)), 0) AS peak_cv,
            stddev_samp(work_j) / nullif(abs(avg(work_j)), 0) AS work_cv
        FROM feature_summary WHERE is_base GROUP BY ALL
    )
    SELECT g.*, d.trace_distance_n FROM groups AS g JOIN distances AS d USING (tool_id, object_id, setup_id);

-- One row per tool with at least one valid grasp. `tool_quality_n` is the mean over the objects measured;
-- with objects missing (`n_missing`, of the 36 of the catalogue) it is not comparable with others.
CREATE VIEW tool_quality AS
    WITH quality AS (
        SELECT
            campaign_id, tool_id, batch, slot, design_id,
            count(DISTINCT object_id) AS n_objects,
            36 - count(DISTINCT object_id) AS n_missing,
            sum(n_repeats)::BIGINT AS n_grasps,
            avg(peak_force_n) AS tool_quality_n,
            stddev_samp(peak_force_n) AS object_sd_n,
            sqrt(avg(repeat_sd_n ** 2)) AS repeat_sd_n,
            avg(work_j) AS work_j
        FROM tool_object GROUP BY ALL
    )
    SELECT
        q.*, b.kind AS batch_kind, d.length_mm, d.width_mm, d.height_mm, d.tip_length_mm, d.front_thickness_mm,
        d.back_thickness_mm, d.rib_thickness_mm, d.rib_count, d.rib_angle_deg, coalesce(d.family, 'fin-ray') AS family,
        d.parameters_json
    FROM quality AS q
    LEFT JOIN designs AS d USING (design_id)
    LEFT JOIN batches AS b USING (campaign_id, batch);

-- One row per campaign and object: how the tools fared on it.
CREATE VIEW object_profile AS
    SELECT
        campaign_id, object_id, object_name, object_class,
        count(*) AS n_tools,
        sum(n_repeats)::BIGINT AS n_grasps,
        avg(peak_force_n) AS peak_force_n,
        stddev_samp(peak_force_n) AS tool_sd_n,
        min(peak_force_n) AS lowest_n,
        max(peak_force_n) AS highest_n,
        arg_max(tool_id, peak_force_n) AS best_tool_id,
        sqrt(avg(repeat_sd_n ** 2)) AS repeat_sd_n,
        avg(work_j) AS work_j,
        avg(initial_force_n) AS initial_force_n
    FROM tool_object GROUP BY ALL;

-- Measured against simulated, per tool, object and simulator version, of the same grasp setup. `gap_n` is measured
-- less simulated.
CREATE VIEW sim_vs_real AS
    SELECT
        r.campaign_id, r.tool_id, r.batch, r.slot, r.design_id, r.object_id, r.object_name,
        r.object_class, s.version_id, v.tier,
        s.simulation_id, r.n_repeats, r.peak_force_n AS real_peak_force_n, s.peak_force_n AS sim_peak_force_n,
        r.peak_force_n - s.peak_force_n AS gap_n, r.repeat_sd_n,
        r.work_j AS real_work_j, s.work_j AS sim_work_j, s.contact_force_n
    FROM tool_object AS r
    JOIN simulations AS s USING (design_id, object_id, setup_id)
    LEFT JOIN simulator_versions AS v ON v.version_id = s.version_id
    WHERE s.status = 'ok';

-- Grasp stability (Fig. 2c): distribution over the tools of the work to break the grasp, per batch and object.
CREATE VIEW stability AS
    SELECT
        campaign_id, batch, object_id, object_name, object_class,
        count(*) AS n_tools,
        min(work_j) AS lowest_j,
        quantile_cont(work_j, 0.25) AS lower_quartile_j,
        median(work_j) AS median_j,
        quantile_cont(work_j, 0.75) AS upper_quartile_j,
        max(work_j) AS highest_j,
        avg(work_j) AS mean_j
    FROM tool_object GROUP BY ALL;
