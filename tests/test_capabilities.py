"""What a user can do, and the test that holds it: one that is renamed or lost is noticed here."""

import ast
from pathlib import Path
from types import SimpleNamespace

ROOT = Path(__file__).parent

CAPABILITIES = {  # file: what a user can do: the test
    "simulators/test_cyclic.py": {
        "structures: degradation, pinching, specimens": "test_force_is_that_of_a_tight_ode_solution",
    },
    "calibration/test_cyclic_tests.py": {
        "structures: measured cyclic tests": "test_the_loops_of_a_column",
        "calibration: CAL of cyclic tests": "test_simulated_loops_at_the_bound",
    },
    "simulators/test_hysteretic.py": {
        "structures: spring_forces": "test_spring_forces_are_labelled",
        "structures: integration_error": "test_estimated_error_over_a_whole_record",
    },
    "structures/test_affine_terms.py": {
        "structures: from_matrices": "test_terms_are_those_made_by_hand",
    },
    "structures/test_opensees.py": {
        "structures: from_opensees": "test_histories_are_those_of_opensees",
    },
    "structures/test_exported_matrices.py": {
        "structures: exported matrices": "test_two_exports_give_the_terms_of_a_parameter",
    },
    "structures/test_names.py": {
        "structures: with_names": "test_responses_by_name_are_those_by_number",
    },
    "modal/test_modes.py": {
        "structures: small motions": "test_a_nonlinear_chain_has_the_modes_of_small_motions",
        "modal: rigid modes": "test_a_rigid_body_has_frequency_zero_and_no_infinite_gradient",
    },
    "simulators/test_quantities.py": {
        "response: quantity=": "test_drift_and_shear_by_hand",
    },
    "simulators/test_linear.py": {
        "response: outputs=": "test_outputs_are_combinations",
        "response: forces": "test_forces_against_lsim",
        "response: n_modes=": "test_chain_with_truncated_modes_and_output_steps",
        "response: rigid-body motion": "test_rigid_bodies_are_found",
        "response: coupled damping": "test_coupled_damping_against_matrix_exponential",
        "response: sparse structures": "test_large_sparse_structure",
    },
    "ops/test_gaps.py": {
        "response: gaps": "test_mean_squares_and_derivatives_of_every_family",
    },
    "simulators/test_band_limited.py": {
        "response: coarse and fine outputs": "test_outputs_between_the_samples_and_fewer",
    },
    "simulators/test_record_tables.py": {
        "response: several inputs": "test_several_inputs_and_coupled_modes_are_marched",
    },
    "simulators/test_massless.py": {
        "response: massless": "test_histories_are_those_of_the_condensed_structure",
    },
    "ambient/test_ambient.py": {
        "response: spectral_response": "test_gradients_of_populations_through_the_structure",
        "ambient: AmbientResponse": "test_log_likelihood_differences_are_those_of_the_gaussian_process",
        "ambient: known base motion": "test_a_known_motion_is_taken_off_the_data",
    },
    "distributions/test_feature_densities.py": {
        "likelihoods: density=": "test_calibration_of_a_response",
    },
    "distributions/test_correlated.py": {
        "likelihoods: correlated errors": "test_density_against_a_dense_covariance",
    },
    "likelihood_free/test_simulator.py": {
        "likelihoods: ABC": "test_uniform_kernel_is_a_step_at_the_tolerance",
    },
    "distributions/test_feature_models.py": {
        "likelihoods: sigma_mpv": "test_sigma_mpv_is_the_mode_of_the_exp_likelihood",
        "likelihoods: abc_tolerance": "test_abc_tolerance",
    },
    "calibration/test_degrees.py": {
        "likelihoods: fill_degrees": "test_white_noise_gives_the_conventional_likelihood",
    },
    "inference/test_tolerance_sweep.py": {
        "likelihoods: tolerance_sweep": "test_intervals_are_the_exact_ones",
    },
    "distributions/test_labels.py": {
        "likelihoods: labels": "test_turned_and_reordered_data_are_the_same_data",
    },
    "modal/test_modal_data.py": {
        "modal: ModalData": "test_what_it_holds",
        "modal: mac": "test_mac",
    },
    "modal/test_match.py": {
        "modal: match_modes": "test_swapped_modes_are_matched_in_every_draw",
    },
    "modal/test_merge_setups.py": {
        "modal: merge_setups": "test_merged_shapes_are_those_they_came_from",
    },
    "update/test_update_modal.py": {
        "modal: set-ups in a file": "test_setups_are_merged",
        "update: modes": "test_posterior_has_the_truth_and_the_report_its_numbers",
    },
    "modal/test_feature.py": {
        "modal: complex shapes": "test_density_against_scipy_and_all_assignments",
    },
    "identification/test_known_input.py": {
        "ambient: identify_modes with a known excitation": "test_deviations_are_as_large_as_said",
    },
    "modal/test_response_functions.py": {
        "modal: FrequencyResponse": "test_log_likelihood_in_closed_form",
    },
    "modal/test_shared_error.py": {
        "modal: repeated identifications": "test_closed_form_against_dense_matrices",
    },
    "identification/test_identification.py": {
        "ambient: identify_modes": "test_intervals_of_two_close_modes_cover",
        "ambient: propose_bands": "test_proposed_bands_hold_the_modes",
    },
    "inference/test_sample.py": {
        "sampling: undetermined": "test_a_direction_that_the_data_do_not_determine_is_named",
        "sampling: distance from Laplace": "test_far_from_laplace_is_said",
        "sampling: no gradient": "test_without_gradients_it_falls_back_and_says_why",
    },
    "smc/test_smc_statistics.py": {
        "sampling: evidence and its error": "test_standard_error_is_calibrated",
        "sampling: TMCMC": "test_conjugate_gaussian",
    },
    "inference/test_compiled.py": {
        "sampling: from_unit_cube": "test_the_unit_cube_is_the_prior",
    },
    "smc/test_sample_smc.py": {
        "sampling: random draws": "test_noisy_simulator_has_its_exact_posterior",
    },
    "smc/test_checkpoint.py": {
        "sampling: checkpoint=": "test_every_kernel_goes_on",
    },
    "smc/test_population.py": {
        "sampling: cores=": "test_parallel_chains_give_the_same_draws",
        "sampling: PopulationMH": "test_same_particles_as_pymc",
    },
    "smc/test_workers.py": {
        "sampling: executor=": "test_local_processes_dask_and_a_killed_worker",
    },
    "smc/test_subset_statistics.py": {
        "sampling: SubsetSimulation": "test_draws_are_those_of_rejection",
    },
    "inference/test_inference.py": {
        "sampling: sample_nuts": "test_nuts_is_the_exact_posterior",
        "sampling: laplace": "test_laplace_is_exact_for_a_gaussian",
        "sampling: fisher_information": "test_fisher_of_a_regression_is_exact",
    },
    "calibration/test_sandwich.py": {
        "calibration: effective_samples": "test_mean_of_a_process_of_first_order",
        "calibration: CAL of responses": "test_coverage",
        "calibration: CAL with gaps": "test_coverage",
    },
    "calibration/test_events.py": {
        "calibration: event_check": "test_joint_q_is_chi_square",
    },
    "events/test_model_classes.py": {
        "events: compare": "test_conjugate_models",
        "events: stacking": "test_average_and_stacking",
    },
    "events/test_hierarchical.py": {
        "events: hierarchical": "test_eight_schools",
    },
    "events/test_sequence.py": {
        "events: continue_with": "test_three_events_are_those_of_the_kalman_filter",
        "events: sample_in_sequence": "test_a_run_that_was_killed_goes_on",
    },
    "prediction/test_prediction.py": {
        "prediction: posterior_response": "test_bands_are_those_of_all_histories",
        "prediction: first_passage_probability": "test_first_passage_of_a_proportional_peak",
    },
    "prediction/test_placement.py": {
        "prediction: sensor_placement": "test_as_good_as_trying_all",
    },
    "external/test_external.py": {
        "external: ExternalSimulator": "test_densities_are_those_of_the_response",
        "external: gradients": "test_gradient_against_differences",
    },
    "external/test_command_line.py": {
        "external: ProgramSimulator": "test_command_line_as_a_simulator",
    },
    "external/test_external_cache.py": {
        "external: cache": "test_results_are_found_again",
    },
    "external/test_emulation.py": {
        "external: emulate": "test_emulate",
    },
    "external/test_external_executors.py": {
        "external: Dask": "test_a_killed_worker_costs_only_its_own_calls",
    },
    "external/test_umbridge.py": {
        "external: UM-Bridge, server": "test_the_protocol",
        "external: UM-Bridge, client": "test_a_posterior_over_the_bridge_is_the_direct_one",
    },
    "io/test_channels_with_gaps.py": {
        "io: read_channels_with_gaps": "test_rows_that_are_missing",
    },
    "io/test_io_cyclic.py": {
        "io: read_cyclic_test": "test_units_and_places",
    },
    "io/test_frequency_response_files.py": {
        "io: read_frequency_response": "test_universal_files",
    },
    "io/test_formats.py": {
        "io: every format of records": "test_record",
        "io: every format of channels": "test_channels",
    },
    "io/test_modal_universal.py": {
        "io: files of modes": "test_normal_modes",
    },
    "io/test_io_matrices.py": {
        "io: matrices": "test_matrix_market",
    },
    "io/test_written_files.py": {
        "io: writers": "test_modes",
    },
    "signals/test_frequency_response.py": {
        "signals: frequency_response": "test_variance_of_blows",
    },
    "signals/test_signals.py": {
        "signals": "test_band_pass_has_the_stated_gain_and_no_phase",
    },
    "study/test_study.py": {
        "study: sampling_rate_study, reproduce": "test_sampled_quantiles_are_the_exact_ones",
        "study: paper": "test_measurements_have_the_stated_noise_once",
        "study: springs that yield": "test_loops_are_those_of_the_response",
    },
    "test_cli.py": {
        "study: reproduce --executor": "test_reproduce_takes_an_executor",
    },
    "plots/test_plots.py": {
        "plots": "test_prior_posterior_figure",
    },
    "plots/test_modal_figures.py": {
        "plots: modes": "test_mac_matrix",
    },
    "update/test_update.py": {
        "update: accelerations": "test_posterior_finds_the_structure_and_its_modes",
        "update: executor": "test_an_executor_gives_the_same_draws",
    },
    "update/test_update_ambient.py": {
        "update: ambient": "test_the_structure_is_found",
    },
    "update/test_update_events.py": {
        "update: events": "test_the_posterior_is_that_of_the_sequence",
    },
    "update/test_update_cyclic.py": {
        "update: cyclic tests": "test_the_truth_is_found_and_reported",
    },
}


def missing(capabilities, items=()):
    """Capabilities without their test: not in its file, or not collected though others of the file are."""
    collected = {}
    for item in items:
        collected.setdefault(item.path, set()).add(getattr(item, "originalname", None))
    found = []
    for file, tests in capabilities.items():
        nodes = [
            node for node in ast.parse((ROOT / file).read_text()).body if isinstance(node, ast.FunctionDef)
        ]
        names = {n.name for n in nodes if not any("mark.skip(" in ast.unparse(d) for d in n.decorator_list)}
        names &= collected.get(ROOT / file, names)
        found += [f"{what}: {file}::{name}" for what, name in tests.items() if name not in names]
    return found


def test_every_capability_has_its_test(request):
    some = request.config.option.keyword or request.config.option.markexpr or "::" in str(request.config.args)
    assert missing(CAPABILITIES, () if some else request.session.items) == []


def test_a_test_that_is_gone_is_noticed():
    """The negative control: of another name, and of one that was left out where the file was collected."""
    told = "flying: test_capabilities.py::test_it_flies"
    assert missing({"test_capabilities.py": {"flying": "test_it_flies"}}) == [told]
    kept = {"test_capabilities.py": {"this": "test_a_test_that_is_gone_is_noticed"}}
    assert missing(kept) == []
    others = [SimpleNamespace(path=ROOT / "test_capabilities.py", originalname="test_other")]
    assert len(missing(kept, others)) == 1
